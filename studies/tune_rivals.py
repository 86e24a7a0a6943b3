"""Chooses the numbers of a planner that learned policies are compared with: the same budget for each.

    python studies/tune_rivals.py vfh_star --json docs/data/rivals/vfh_star_tuning.json    # or another of RIVALS

Settings are drawn at random around the present ones, which take part, too. All fly the same tasks in valleys 200 to
209, which no evaluation uses, with twice the default's obstacles. The better quarter flies four times as many, and so
on until fewer than two would be; the last round decides.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from tune_vfh import SEED, VALLEYS

from uavrl.config import compose, validate
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.planners.mppi import MPPI, MPPIWeights
from uavrl.planners.potential_field import FieldWeights, PotentialField
from uavrl.planners.rrt_connect import RRTConnect, RRTConnectWeights
from uavrl.planners.rrt_map import RRTMap
from uavrl.planners.vfh_star import VFHStar, VFHStarWeights
from uavrl.runs.episodes import success_text, wilson
from uavrl.runs.provenance import versions
from uavrl_onboard.cli.process import one_sentence

OBSTACLES = 90
VEHICLES = 4  # at a time; how many changes no task, and fewer idle while the last ones fly


class Tuned(NamedTuple):
    """A planner, and from where to where its numbers are drawn, uniformly in the logarithm."""

    made: Callable[..., Any]
    costs: type
    ranges: Mapping[str, tuple[float, float]]


PLANS = {
    "ahead": (2.5, 4.0),
    "near": (0.1, 0.3),
    "far": (0.4, 1.2),
    "lead": (0.25, 1.0),
    "keep": (0.6, 1.0),
    "carrot": (0.5, 1.5),
    "slow": (0.4, 1.2),
    "watch": (0.8, 2.5),
    "reflex": (0.4, 1.2),
    "distance": (0.3, 0.6),
    "gain": (0.5, 2.0),
}

RIVALS = {
    "vfh_star": Tuned(
        VFHStar,
        VFHStarWeights,
        {
            "blocked": (1.0, 20.0),
            "obstacle": (0.5, 5.0),
            "level": (0.1, 0.6),
            "change": (0.05, 0.6),
            "near": (0.05, 0.25),
            "far": (0.4, 1.2),
            "reach": (2.0, 4.0),
            "soon": (0.5, 3.0),
            "step": (0.6, 1.5),
            "discount": (0.5, 1.0),
            "caution": (0.2, 0.95),
            "brake": (0.4, 1.2),
        },
    ),
    "mppi": Tuned(
        MPPI,
        MPPIWeights,
        {
            "collision": (5.0, 100.0),
            "obstacle": (0.5, 10.0),
            "across": (0.1, 1.0),
            "level": (0.1, 1.0),
            "effort": (0.01, 1.0),
            "near": (0.05, 0.25),
            "far": (0.4, 1.2),
            "speed": (1.4, 2.8),
            "climb": (0.2, 1.0),
            "spread": (0.4, 1.5),
            "temperature": (0.03, 1.0),
        },
    ),
    "potential_field": Tuned(
        PotentialField,
        FieldWeights,
        {"attraction": (0.5, 3.0), "repulsion": (0.02, 3.0), "reach": (0.5, 3.5), "level": (0.3, 2.0)},
    ),
    "rrt_connect": Tuned(RRTConnect, RRTConnectWeights, PLANS),
    "rrt_map": Tuned(RRTMap, RRTConnectWeights, PLANS),
}


def drawn(rival: Tuned, count: int) -> list[dict[str, float]]:
    """The present settings, and others at random."""
    rng, present = np.random.default_rng(0), asdict(rival.costs())
    settings = [present]
    while len(settings) < count:
        other = {key: float(np.exp(rng.uniform(*np.log(ends)))) for key, ends in rival.ranges.items()}
        settings.append(present | other)
    return settings


def flown(env: Any, rival: Tuned, setting: Mapping[str, float], tasks: int) -> dict[str, Any]:
    """What a setting comes to; ties go to the one that is sooner there."""
    env.set_seed(SEED)
    flights = rollout_episodes(env, rival.made(costs=rival.costs(**setting)), tasks)
    arrived = [flight.steps for flight in flights if flight.outcome == "arrived"]
    steps = float(np.mean(arrived)) if arrived else float("inf")
    collided = sum(flight.outcome == "collided" for flight in flights)
    return {"setting": setting, **wilson(len(arrived), tasks), "collided": collided / tasks, "steps": steps}


def main() -> None:
    """Prints each round, best first."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rival", choices=RIVALS)
    parser.add_argument("--settings", type=int, default=8)
    parser.add_argument("--tasks", type=int, default=12, help="of each setting in the first round")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    rival = RIVALS[args.rival]
    config = validate(compose(f"env.world.seeds={VALLEYS}", f"env.world.obstacles={OBSTACLES}"))
    seen: dict[str, Any] = {"keep_cloud": True, "mark_resets": True, "seed": SEED, "num_uavs": VEHICLES}
    env = make_env(config.env, config.perception, **seen)
    left, tasks = drawn(rival, args.settings), args.tasks
    rounds: list[list[dict[str, Any]]] = []
    while True:
        found = [flown(env, rival, setting, tasks) for setting in left]
        rounds.append(sorted(found, key=lambda row: (-row["rate"], row["steps"])))
        print(f"{len(left)} settings, {tasks} tasks each")
        for row in rounds[-1][:8]:
            told = {key: float(f"{value:.3g}") for key, value in row["setting"].items()}
            rest = f"collided {100 * row['collided']:.1f} %, {row['steps']:.0f} steps"
            print(f"  {success_text(row, tasks)}, {rest}  {told}", flush=True)
        if len(left) < 8:
            break
        left, tasks = [row["setting"] for row in rounds[-1][: len(left) // 4]], 4 * tasks
    if args.json:
        told = {"versions": versions(), "valleys": VALLEYS, "obstacles": OBSTACLES, "rounds": rounds}
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
