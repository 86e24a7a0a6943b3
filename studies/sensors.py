"""How does a policy that was trained with a VLP-16 in valleys fly with other sensors and in other worlds, as it is?

Run `python studies/sensors.py --episodes 200 --output sensors.json`. The tasks are those of `uavrl-evaluate`, in ten
unseen places of each world (in valleys the suite's row `held_out`), for every sensor with and without guards; the
camera flies without evasion. Rows that the output already holds are kept, so that a study that was stopped goes on
where it was. Cells that a sensor never sees are counted; the policy takes them for free.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import torch

from uavrl import load_policy
from uavrl.config import validate
from uavrl.envs.sensors import SENSORS
from uavrl.evaluation.field_of_view import check_field_of_view, trained_sensor
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.evaluation.summary import summarize
from uavrl.runs.episodes import rate_cell
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.files import replacing

PLACES = range(100, 110)  # of uavrl-evaluate
SEED = 20_000
WORLDS = ("static", "forest", "rooms")
CAMERA = "map, shield"  # guards of the depth camera, for which what it turns towards would seem to move
GUARDS: dict[str, Any] = {CAMERA: ["map", "shield", {"map": {"sight": 10.0}}]}  # it reaches 10 m


def row(policy: str, world: str, sensor: str, guards: str, episodes: int, vehicles: int) -> dict[str, Any]:
    """One sensor in one world, with or without guards."""
    loaded, begun = load_policy(policy), time.monotonic()
    options = {"valleys": list(PLACES), "seed": SEED, "num_uavs": min(vehicles, episodes)}
    options["guards"] = GUARDS.get(guards, guards)
    env = loaded.make_env(f"env={world}", "randomize=none", f"env.lidar={sensor}", allow_unseen=True, **options)
    try:
        found = summarize(rollout_episodes(env, loaded, episodes, progress=False))
    finally:
        env.close()
    perception, trained = validate(loaded.config).perception, trained_sensor(loaded.config)
    flown = {**perception, "lidar": replace(perception["lidar"], sensor=sensor)}
    unseen = check_field_of_view(flown, trained, allowed=True)
    kept = ("success", "outcomes", "steps_per_arrival")
    told = {"policy": policy, "world": world, "sensor": sensor, "guards": guards, "episodes": episodes, "seed": SEED}
    return told | {key: found[key] for key in kept} | {"unseen_cells": unseen, "seconds": time.monotonic() - begun}


def line(found: dict[str, Any]) -> str:
    """One row of the table."""
    steps, collided = found["steps_per_arrival"], 100 * found["outcomes"].count("C") / len(found["outcomes"])
    took = "–" if steps is None else f"{steps:.0f}"
    named = f"| `{found['world']}` | `{found['sensor']}` | {found['guards']} | {found['unseen_cells']} | "
    return f"{named}{rate_cell(found['success'])} | {collided:.1f} | {took} | {found['episodes']} |"


def main(words: Sequence[str] | None = None) -> None:
    """Flies all rows and prints them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="best")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--vehicles", type=int, default=8)
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS))
    parser.add_argument("--sensors", nargs="+", default=list(SENSORS))
    parser.add_argument("--guards", nargs="+", default=["none", "all"])
    parser.add_argument("--output", type=Path, default=Path("sensors.json"))
    args = parser.parse_args(words)
    torch.set_num_threads(1)
    rows = json.loads(args.output.read_text(encoding="utf-8")) if args.output.is_file() else []
    columns = ("world", "sensor", "guards", "cells never seen", "success, % (95 % CI)", "collisions, %")
    columns = (*columns, "steps per success", "tasks")
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for world, asked, sensor in product(args.worlds, args.guards, args.sensors):
        guards = CAMERA if (sensor, asked) == ("d435", "all") else asked
        told = {"policy": args.policy, "world": world, "sensor": sensor, "guards": guards, "episodes": args.episodes}
        found = next((each for each in rows if told.items() <= each.items()), None)
        if found is None:
            found = row(args.policy, world, sensor, guards, args.episodes, args.vehicles)
            rows.append(found)
            with replacing(args.output) as partial:
                partial.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        print(line(found), flush=True)


if __name__ == "__main__":
    with one_sentence():
        main()
