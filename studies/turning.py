"""How fast should the scripted controller turn, and should it keep to the side that it has chosen?

    python studies/turning.py --json docs/data/guided/turning.json

Its variants on 72 cells in valleys 200 to 209, which no result uses: success with 45 obstacles and vehicles that are
not as believed, and with 90 obstacles and vehicles as believed, and how much the action changes from step to step.
Each variant takes some minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch

from uavrl.config import compose, validate
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.evaluation.summary import summarize
from uavrl.policies import baselines
from uavrl_onboard.cli.process import one_sentence

SEEN = ("range_image", "proximity")
FAST = {"TURN_GAIN": 3.0, "TURN_LIMIT": 2.0}
ALONE = {"SHARPNESS": 1e9}  # the best direction is not blended with its neighbours
SIDES = {"change": 0.0}  # it does not keep to a side
# What differs from the controller of today: module constants, costs
VARIANTS: dict[str, tuple[Mapping[str, float], Mapping[str, float]]] = {
    "3 /s, at most 2 rad/s, not blended, no cost of changes": (FAST | ALONE, SIDES),
    "the same, blended": (FAST, SIDES),
    "1 /s, at most 1 rad/s, not blended, no cost of changes": ({"TURN_GAIN": 1.0} | ALONE, SIDES),
    "0.6 /s, at most 1 rad/s, blended, no cost of changes": ({}, SIDES),
    "today's: the same, 0.15 for a change": ({}, {}),
    "0.4 for a change": ({}, {"change": 0.4}),
    "today's, obstacle 1.5": ({}, {"obstacle": 1.5}),
    "today's, width 4": ({}, {"width": 4.0}),
}
WORLDS = {
    "45 obstacles, randomised": ["env.world.obstacles=45", "randomize=real"],
    "90 obstacles, as believed": ["env.world.obstacles=90", "randomize=none"],
}


def flown(world: list[str], costs: Mapping[str, float], tasks: int, valleys: int) -> dict[str, Any]:
    """What a variant of the controller comes to."""
    seeds = f"env.world.seeds={list(range(200, 200 + valleys))}".replace(" ", "")
    settings = validate(compose("perception=range_image", "perception.last_action=true", seeds, *world))
    env = make_env(settings.env, settings.perception, seed=30_000, num_uavs=8, measure_clearance=True)
    weights = replace(baselines.COSTS[SEEN], **costs)  # type: ignore[index]
    rule = baselines.VectorFieldHistogram(reduction="range_image", costs=weights, last_action=True)
    try:
        return summarize(rollout_episodes(env, rule, tasks))
    finally:
        env.close()


def main() -> None:
    """Flies all, and prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tasks", type=int, default=200)
    parser.add_argument("--valleys", type=int, default=10, help="how many, from 200 on")
    parser.add_argument("--only", nargs="+", help="numbers of variants, from 0")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    args = parser.parse_args()
    torch.set_num_threads(1)
    result: dict[str, dict[str, Any]] = {}
    print("| variant | world | success | steps | change of forward, left, up, yaw rate |\n|---|---|---|---|---|")
    for number, (name, (constants, costs)) in enumerate(VARIANTS.items()):
        if args.only and str(number) not in args.only:
            continue
        for world, overrides in WORLDS.items():
            with patch.multiple(baselines, **{"TURN_GAIN": baselines.TURN_GAIN, **constants}):
                row = flown(overrides, costs, args.tasks, args.valleys)
            result.setdefault(name, {})[world] = row
            change = ", ".join(f"{value:.2f}" for value in row["action_change"])
            success, steps = row["success"]["rate"], row["steps_per_episode"]
            print(f"| {name} | {world} | {success:.1%} | {steps:.0f} | {change} |", flush=True)
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
