"""Chooses the costs of `policy=vfh` in training valleys: which are best there, and nothing else, is asked.

    python studies/tune_vfh.py [perception=NAME perception.key=value …] [--settings 32] [--tasks 64] [--json FILE]

Settings are drawn at random; the present ones take part, too. All fly the same tasks in valleys 200 to
209, which no evaluation uses, half of them with the default's obstacles and half with twice as many. The better quarter
flies four times as many, and so on until one is left.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from uavrl.config import compose, validate
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.policies.baselines import COSTS, VectorFieldHistogram, VFHWeights
from uavrl.runs.episodes import success_text, wilson
from uavrl.runs.provenance import versions
from uavrl_onboard.cli.process import one_sentence

VALLEYS = list(range(200, 210))
OBSTACLES = (45, 90)
SEED, VEHICLES = 30_000, 16
RANGES = {  # drawn uniformly in the logarithm
    "obstacle": (0.5, 20.0),
    "goal": (0.3, 3.0),
    "level": (0.02, 1.0),
    "turn": (0.02, 1.0),
    "width": (1.0, 20.0),
    "nearness": (0.5, 8.0),
    "caution": (0.3, 1.0),
}


def drawn(count: int, present: dict[str, float]) -> list[dict[str, float]]:
    """The present settings, and others at random."""
    rng = np.random.default_rng(0)
    settings = [present]
    while len(settings) < count:
        settings.append({key: float(np.exp(rng.uniform(*np.log(ends)))) for key, ends in RANGES.items()})
    return settings


def arrivals(environments: list[Any], rule: VectorFieldHistogram, tasks: int) -> int:
    """How many of the tasks, shared evenly between the environments, are solved."""
    solved = 0
    for env in environments:
        env.set_seed(SEED)
        flights = rollout_episodes(env, rule, tasks // len(environments))
        solved += sum(flight.outcome == "arrived" for flight in flights)
    return solved


def main() -> None:
    """Prints what is left after each round, best first."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("overrides", nargs="*", help="perception.key=value")
    parser.add_argument("--settings", type=int, default=32)
    parser.add_argument("--tasks", type=int, default=64, help="of each setting in the first round")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    environments = []
    for obstacles in OBSTACLES:
        config = validate(compose(f"env.world.seeds={VALLEYS}", f"env.world.obstacles={obstacles}", *args.overrides))
        environments.append(make_env(config.env, config.perception, config.reward, seed=SEED, num_uavs=VEHICLES))
    flown = (config.perception.flight_level, config.perception.radius)
    seen = (config.perception.reduction, config.perception.statistic)
    present = asdict(COSTS.get(seen, COSTS["range_image", "proximity"]))
    left, tasks = drawn(args.settings, present), args.tasks
    rounds: list[list[dict[str, Any]]] = []
    while left:
        rules = [VectorFieldHistogram(*flown, *seen, VFHWeights(**setting)) for setting in left]
        found = [(arrivals(environments, rule, tasks), each) for rule, each in zip(rules, left, strict=True)]
        found.sort(key=lambda pair: -pair[0])
        rounds.append([{"setting": setting, **wilson(solved, tasks)} for solved, setting in found])
        print(f"{len(left)} settings, {tasks} tasks each; present ones: {present}")
        for row in rounds[-1][:8]:
            told = {key: round(value, 3) for key, value in row["setting"].items()}
            print(f"  {success_text(row, tasks)}  {told}", flush=True)
        if len(left) == 1:
            break
        left, tasks = [setting for _, setting in found[: max(1, len(left) // 4)]], 4 * tasks
    if args.json:
        told = {
            "versions": versions(),
            "perception": seen,
            "valleys": VALLEYS,
            "obstacles": OBSTACLES,
            "rounds": rounds,
        }
        args.json.write_text(json.dumps({**told, "rounds": rounds}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
