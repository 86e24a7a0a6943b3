"""What does not seeing bring? Blind flights through a valley, by every way around its obstacles that we could think of.

    python benchmarks/loopholes.py                      # the static valley, 200 tasks for each controller
    python benchmarks/loopholes.py env.world.obstacles=90
    python benchmarks/loopholes.py env=dynamic --json audit.json

A world can be learned blindly if any of these arrives often. Beside them belongs a policy that *learned* blindly:
`uavrl-train perception.blind=true`, evaluated with `uavrl-evaluate run=FOLDER`.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from common import experiment, machine
from numpy.typing import ArrayLike
from tensordict import TensorDictBase

from uavrl.envs import NavigationEnv
from uavrl.envs.world import World
from uavrl.evaluation.environment import make_env
from uavrl.runs.episodes import outcome, rate_cell, wilson
from uavrl.transforms.state import ACTION_LIMIT
from uavrl_onboard.cli.process import one_sentence

Way = Callable[[np.ndarray, np.ndarray, np.random.Generator], list[np.ndarray]]
REACHED = 0.5  # m from a point of its way at which a UAV turns to the next one
AT_WALL = 1.2  # m from the border to the face of the wall at flight level


def along(*points: ArrayLike) -> list[np.ndarray]:
    """The points themselves, as ``[3]`` each."""
    return [np.asarray(point, dtype=float) for point in points]


def straight(level: float) -> Way:
    """Towards the goal, on a level that is reached on the way."""
    return lambda start, goal, rng: along([*goal[:2], level])


def level_first(level: float) -> Way:
    """Up or down on the spot, then towards the goal."""
    return lambda start, goal, rng: along([*start[:2], level], [*goal[:2], level])


def by_wall(edge: int, distance: float, half: np.ndarray, origin: np.ndarray) -> Way:
    """Sideways to the lane along one wall, along it, and sideways to the goal."""

    def way(start: np.ndarray, goal: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
        axis, side = edge // 2, (1 if edge % 2 else -1)
        into, out = start.copy(), np.array([*goal[:2], start[2]])
        into[axis] = out[axis] = origin[axis] + side * (half[axis] - AT_WALL - distance)
        return along(into, out, [*goal[:2], start[2]])

    return way


def by_random_place(half: np.ndarray, origin: np.ndarray) -> Way:
    """Over two random legs."""
    return lambda start, goal, rng: along(
        [*(origin + rng.uniform(-1, 1, 2) * (half - 3)), start[2]], [*goal[:2], start[2]]
    )


class Pilot:
    """Flies every UAV along its way, without turning, at the speed that the action space allows."""

    def __init__(self, way: Way, count: int) -> None:
        self.way, self.tasks = way, np.full(count, -1)
        self.ways: list[list[np.ndarray]] = [[] for _ in range(count)]

    def __call__(self, state: TensorDictBase) -> TensorDictBase:
        """Writes ``action``."""
        position, goal = state["position"].double().numpy(), state["goal"].double().numpy()
        tasks, heading = state["task"].numpy()[:, 0], np.radians(state["heading_deg"].numpy()[:, 0])
        to_goal = goal - position
        yaw = np.arctan2(to_goal[:, 1], to_goal[:, 0]) - heading
        actions = np.zeros((len(tasks), 4), dtype=np.float32)
        for i, task in enumerate(tasks):
            if task != self.tasks[i]:
                self.tasks[i] = task
                self.ways[i] = self.way(position[i], goal[i], np.random.default_rng([7, task]))
            actions[i, :3] = self._velocity(i, position[i], yaw[i])
        return state.set("action", torch.from_numpy(actions))

    def _velocity(self, i: int, position: np.ndarray, yaw: float) -> np.ndarray:
        """Towards the next point of the way, in the yaw-aligned body frame."""
        apart = self.ways[i][0] - position
        if np.linalg.norm(apart) < REACHED and len(self.ways[i]) > 1:
            self.ways[i].pop(0)
            apart = self.ways[i][0] - position
        cos, sin = np.cos(yaw), np.sin(yaw)
        wanted = 2.0 * np.array([cos * apart[0] + sin * apart[1], cos * apart[1] - sin * apart[0], apart[2]])
        wanted[:2] *= min(1.0, ACTION_LIMIT / max(float(np.linalg.norm(wanted[:2])), 1e-9))
        return np.clip(wanted, -ACTION_LIMIT, ACTION_LIMIT)


def arrivals(env: NavigationEnv, way: Way, tasks: int, seed: int) -> dict[str, Any]:
    """Flies the first tasks of a seed and counts how they end."""
    env.set_seed(seed)
    pilot = Pilot(way, env.num_uavs)
    ended: dict[int, str] = {}
    state = env.reset()
    while len(ended) < tasks:
        stepped, state = env.step_and_maybe_reset(pilot(state))
        for last in stepped["next"][stepped["next", "done"][:, 0]]:
            if last["task"].item() < tasks:
                ended[last["task"].item()] = outcome(last)
    counts = Counter(ended.values())
    return {"success": wilson(counts["arrived"], tasks), **counts}


def controllers(world: World) -> dict[str, Way]:
    """Every blind way through the first valley of a world, by name."""
    half, origin = np.array(world.config.size) / 2, world.places[0].origin
    levels = np.arange(0.5, world.config.ceiling, 0.5)
    walls = {0: "-x", 1: "+x", 2: "-y", 3: "+y"}
    return {
        **{f"straight at {level:.1f} m": straight(level) for level in levels},
        **{f"first to {level:.1f} m, then straight": level_first(level) for level in levels},
        **{
            f"along the wall at {name}, {distance} m from it": by_wall(edge, distance, half, origin)
            for edge, name in walls.items()
            for distance in (1, 2, 3)
        },
        "over two random legs": by_random_place(half, origin),
    }


def main() -> None:
    """Prints the audit as a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*", help="of uavrl-train: env=dynamic, env.world.obstacles=90, …")
    parser.add_argument("--tasks", type=int, default=200)
    parser.add_argument("--seed", type=int, default=77777)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    config = experiment("perception.blind=true", *arguments.overrides)
    env = make_env(config.env, config.perception, num_uavs=16).base_env
    rows = {}
    print(f"| blind flight, {arguments.tasks} tasks | success, % (95 % CI) |\n|---|---|")
    for name, way in controllers(env.world).items():
        rows[name] = arrivals(env, way, arguments.tasks, arguments.seed)
        print(f"| {name} | {rate_cell(rows[name]['success'])} |", flush=True)
    if arguments.json:
        about = {"overrides": arguments.overrides, "tasks": arguments.tasks, "seed": arguments.seed}
        arguments.json.write_text(
            json.dumps({**about, "machine": machine(), "rows": rows}, indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    with one_sentence():
        main()
