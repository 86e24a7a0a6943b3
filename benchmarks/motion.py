"""What it costs an environment step to look for moving objects, and to fly with guards.

Run `python benchmarks/motion.py [--json FILE]`. All rows fly the default's eight vehicles among ten planes, with the
same random actions, on one thread and up to what the policy reads; an episode that ends begins anew. Rows are
interleaved and repeated; medians count.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import torch
from common import experiment, machine
from flights import Row, measure, stepping

from uavrl.evaluation.environment import make_env
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.guards.settings import guard_settings

ROWS = {
    "neither": [],
    "perception.motion=12": ["perception.motion=12"],
    "perception.motion=8": ["perception.motion=8"],
    "guards=[map]": ["map"],
    "guards=[evasion]": ["evasion"],
    "guards=[shield]": ["shield"],
    "guards=all": ["all"],
}
SEEN = ["env=dynamic", "perception=range_image", "perception.last_action=true"]


def flying(steps: int, uavs: int, overrides: list[str]) -> Row:
    """Return a row that measures milliseconds per vehicle step."""
    guards = guard_settings([each for each in overrides if "=" not in each])
    settings = experiment(*SEEN, *(each for each in overrides if "=" in each))
    parts = (settings.env, settings.perception, settings.reward)
    env = make_env(*parts, seed=settings.seed, num_uavs=uavs, guards=guards)
    return stepping(env, steps, uavs)


def main() -> None:
    """Measures, and tells."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--uavs", type=int, default=8)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--repeats", type=int, default=8)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    about = machine()
    found = measure({name: flying(args.steps, args.uavs, told) for name, told in ROWS.items()}, args.repeats)
    for name, value in found.items():
        print(f"{name:22} {value:6.2f} ms per vehicle step, {value / found['neither']:.2f} times")
    if args.json:
        content = {"machine": about, "uavs": args.uavs, "ms_per_uav_step": found}
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
