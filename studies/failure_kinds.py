"""How does a policy fail? Names the kind of each failure in a row of the suite.

    python studies/failure_kinds.py busy dynamic denser traps --episodes 100 --output failures.json

Among planes, a collision counts as one with a plane if the middles of both are within 1.3 m at the end. A plane was in
view in a scan if some of its height was between 15° below and 15° above the LiDAR's horizontal plane, whatever stood in
between. It dives or climbs if it did so at any time in the last two seconds. Time-outs are divided by how far the
vehicle moved in its last ten seconds. The tasks are the first ones of the suite's row, but planes move with the steps
of all vehicles, so that other flights meet other planes.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from uavrl import load_policy
from uavrl.envs import NavigationEnv
from uavrl.evaluation.rollout import rollout
from uavrl.evaluation.suite import scenarios
from uavrl.runs.episodes import outcome
from uavrl.runs.provenance import versions
from uavrl_onboard.cli.process import one_sentence

SEED = 20_000  # of evaluations
TOUCH = 1.3  # m between the middles of a vehicle and a plane
VIEW = np.radians(15)  # of the VLP-16
LATELY = 20  # steps before a collision
SCANS = 3  # after which the sight of motion calls an object moving
LAST = 100  # steps before a time-out
STILL = 3.0  # m
STEEP = 0.1  # m/s up or down, above which a plane is not level


class Step(NamedTuple):
    """What is kept of a vehicle's step."""

    position: np.ndarray  # [3], m
    distances: np.ndarray  # [K] m to the middles of planes
    in_view: np.ndarray  # [K], which of them the LiDAR can see if nothing stands between
    is_steep: np.ndarray  # [K], which of them dive or climb


def look(env: NavigationEnv, vehicle: int) -> Step:
    """The planes as a vehicle has them around it."""
    simulation = env.simulation
    ways = env.traffic.positions - simulation.lidar_position[vehicle]
    seen = ways @ simulation.rotation[vehicle]  # in body axes
    distances = np.linalg.norm(ways, axis=-1)
    elevation = np.abs(np.arctan2(seen[:, 2], np.linalg.norm(seen[:, :2], axis=-1)))
    height = np.abs(env.plane_mesh.vertices[:, 2]).max()  # m above and below a plane's middle
    in_view = elevation <= VIEW + np.arctan2(height, distances)
    is_steep = np.abs(env.traffic.velocities()[:, 2]) > STEEP
    return Step(simulation.position[vehicle].copy(), distances, in_view, is_steep)


def kind(ending: str, steps: Sequence[Step]) -> str:
    """The kind of a failure, in words."""
    if ending == "timed_out":
        last = np.stack([step.position[:2] for step in steps])
        return "time-out, within 3 m" if np.ptp(last, axis=0).max() < STILL else "time-out, on its way"
    last_distances = steps[-1].distances
    if not last_distances.size or last_distances.min() > TOUCH:
        return "obstacle"
    plane = int(last_distances.argmin())
    lately = list(steps)[-LATELY:]
    flies = "dives or climbs" if any(step.is_steep[plane] for step in lately) else "flies level"
    scans = sum(bool(step.in_view[plane]) for step in lately[:-1])
    return f"plane that {flies}, " + ("in view for three scans or more" if scans >= SCANS else "hardly ever in view")


def failures(policy: str, row: str, episodes: int, vehicles: int, guards: str) -> Iterator[tuple[int, str]]:
    """The task and the kind of each failure."""
    changes = list(scenarios([row])[row])
    options: dict[str, Any] = {"guards": guards, "seed": SEED, "num_uavs": vehicles}
    for change in [each for each in changes if each.startswith("valleys=")]:
        changes.remove(change)
        options["valleys"] = json.loads(change.partition("=")[2])
    loaded = load_policy(policy)
    env = loaded.make_env(*changes, *([] if row == "real" else ["randomize=none"]), **options)
    base = env.base_env
    assert isinstance(base, NavigationEnv)
    kept: list[deque[Step]] = [deque(maxlen=LAST) for _ in range(vehicles)]
    left = episodes
    try:
        for stepped in rollout(env, loaded, env.reset()):
            after = stepped["next"]
            done = after["done"].reshape(-1)
            for vehicle in range(vehicles):
                kept[vehicle].append(look(base, vehicle))
                if not done[vehicle]:
                    continue
                task, ending = int(after["task"][vehicle]), outcome(after[vehicle])
                if task < episodes:
                    left -= 1
                    if ending != "arrived":
                        yield task, kind(ending, kept[vehicle])
                kept[vehicle].clear()
            if not left:
                return
    finally:
        env.close()


def main(words: Sequence[str] | None = None) -> None:
    """Prints how many failures of each kind a row has, and writes them all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="+", help="of the suite")
    parser.add_argument("--policy", default="best")
    parser.add_argument("--guards", default="all")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--vehicles", type=int, default=8)
    parser.add_argument("--output", type=Path)
    args = parser.parse_args(words)
    torch.set_num_threads(1)
    told: dict[str, Any] = {"policy": args.policy, "guards": args.guards, "episodes": args.episodes}
    told |= {"vehicles": args.vehicles, "versions": versions(), "rows": {}}
    for row in args.rows:
        found = dict(sorted(failures(args.policy, row, args.episodes, args.vehicles, args.guards)))
        told["rows"][row] = found
        counts = Counter(found.values())
        print(f"{row}: {len(found)} failures of {args.episodes} tasks", flush=True)
        for name, count in counts.most_common():
            print(f"  {count:3d}  {name}", flush=True)
        if args.output:
            args.output.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
