"""How does a planner do that knows the map, beside the policies that have to look?

    python studies/known_map.py --rows static held_out dense denser [--tasks 500] [--narrow 2] [--json FILE]

A planner is given the map of the free space from which the tasks are drawn. From the goal it finds the shortest way to
everywhere (Dijkstra; narrow places count double), sees how far ahead the way is straight and free, and flies there:
turned by 45 degrees, since each component of the action has its own limit and the diagonal is the fastest. It has no
LiDAR. The same tasks as in the suite. It is no bound: no way is shorter, but others fly it faster or with more care.
Nobody can be there sooner than straight on at 2.83 m/s; that is the last column.
"""

from __future__ import annotations

import argparse
import json
import math
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from uavrl.config import EvaluateConfig, compose, validate
from uavrl.config.build import build
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.envs.place import free_space
from uavrl.envs.tasks import FlightMap
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.evaluation.suite import scenarios
from uavrl.runs.episodes import LETTERS, rate_cell, wilson
from uavrl.transforms.state import ACTION_LIMIT
from uavrl_onboard.cli.process import one_sentence

ROWS = ("static", "held_out", "dense", "denser")
AHEAD = 16  # places of the way that are looked at
KEPT = 0.55  # m from the middle of the vehicle to everything, on what counts as free straight on; the hull has 0.35
NEXT = 2  # places ahead: to that one it flies where nothing is free straight on
WIDE, TIGHT = 0.6, 0.35  # m to either side: from the one on it flies at full speed, at the other at the slowest
SLOWEST, FASTEST = 0.5, ACTION_LIMIT * math.sqrt(2)  # m/s, the latter level
NARROW = 2.0  # times the length that a way counts through the narrowest place
BRAKE = 0.7  # s, in which it would fly what it sees of its way
LAG = 0.3  # s, that it looks ahead of itself
TURN = 1.0  # rad/s, the fastest that it turns


class Ways:
    """The shortest ways in one valley's free space.

    Args:
        flight: its map.
        narrow: times the length that a way counts through the narrowest place.
    """

    def __init__(self, flight: FlightMap, narrow: float = NARROW) -> None:
        self.space, self.narrow = flight.space, narrow
        self._index = np.full(flight.corridor.shape, -1)
        self._index[flight.corridor] = np.arange(flight.corridor.sum())
        self.places = self.space.points[flight.corridor]  # [M, 3] m, in the valley's frame
        self._clearance = self.space.clearance[flight.corridor]
        self._tree = cKDTree(self.places)

    @cached_property
    def graph(self) -> csr_array:
        """Between neighbours, also across corners, where the hull fits: distances in m, more where it is narrow."""
        first, second, cost = [], [], []
        for offset in product((-1, 0, 1), repeat=3):
            if offset <= (0, 0, 0):
                continue  # the same neighbours from the other side
            here = tuple(slice(max(-o, 0), min(-o, 0) or None) for o in offset)
            there = tuple(slice(max(o, 0), min(o, 0) or None) for o in offset)
            a, b = self._index[here].ravel(), self._index[there].ravel()
            a, b = (each[(a >= 0) & (b >= 0)] for each in (a, b))
            length = np.linalg.norm(self.places[a[0]] - self.places[b[0]]) if len(a) else 0.0
            room = (self._clearance[a] + self._clearance[b] - length) / 2
            narrow = ((WIDE - room) / WIDE).clip(0, 1)
            fits = room > 0.1
            first.append(a[fits])
            second.append(b[fits])
            cost.append((length * (1 + (self.narrow - 1) * narrow))[fits])
        a, b, costs = (np.concatenate(each) for each in (first, second, cost))
        count = len(self.places)
        return csr_array(coo_array((np.tile(costs, 2), (np.r_[a, b], np.r_[b, a])), (count, count)))

    def to(self, goal: np.ndarray, radius: float) -> np.ndarray:
        """For each place the next one on its way to the cylinder around ``goal [3]``, or a negative number: ``[M]``."""
        apart = np.linalg.norm(self.places[:, :2] - goal[:2], axis=1)
        ends = np.flatnonzero(apart <= max(radius / 2, apart.min()))
        return np.asarray(dijkstra(self.graph, indices=ends, min_only=True, return_predecessors=True)[1])

    def towards(self, place: np.ndarray, following: np.ndarray) -> tuple[np.ndarray, float]:
        """Where to fly straight from ``place [3]``: the way there ``[3]`` in m, and how wide it is at first, in m."""
        at = int(self._tree.query(place)[1])
        way = [at]
        while len(way) < AHEAD and following[at] >= 0:
            at = int(following[at])
            way.append(at)
        ends = self.places[way]
        between = place + np.linspace(0.0, 1.0, 24)[:, None, None] * (ends - place)
        wide = self._wide(between)  # [24, ends]
        free = np.flatnonzero((wide >= KEPT).all(0))
        chosen = free[-1] if len(free) else min(NEXT, len(way) - 1)
        first = np.linalg.norm(between[:, chosen] - place, axis=-1) < 0.7
        return ends[chosen] - place, float(wide[first, chosen].min())

    def _wide(self, points: np.ndarray) -> np.ndarray:
        """Clearance in m at ``points [..., 3]``, interpolated in the map."""
        axes = (self.space.x, self.space.y, self.space.z)
        at = np.stack([(points[..., i] - axis[0]) / (axis[1] - axis[0]) for i, axis in enumerate(axes)])
        return np.asarray(map_coordinates(self.space.clearance, at, order=1, mode="nearest"))


def command(apart: np.ndarray, wide: float, velocity: np.ndarray, yaw: float) -> np.ndarray:
    """The action ``[4]`` that flies to what lies ``apart [3]`` m away, on a way ``wide`` m to either side.

    What the velocity of now lacks is asked for on top, since the vehicle follows with a lag.

    Args:
        apart: world axes, m.
        wide: m.
        velocity: ``[3]``, world axes, m/s.
        yaw: rad.
    """
    distance = max(float(np.linalg.norm(apart)), 1e-6)
    cos, sin = math.cos(yaw), math.sin(yaw)
    to_body = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    way, flown = to_body @ apart / distance, to_body @ velocity
    fast = min(distance / BRAKE, FASTEST * (wide - TIGHT) / (WIDE - TIGHT))
    asked = min(max(fast, SLOWEST), ACTION_LIMIT / np.abs(way).max()) * way
    bearing = math.atan2(way[1], way[0])
    turn = min((math.remainder(bearing + corner, 2 * math.pi) for corner in (-math.pi / 4, math.pi / 4)), key=abs)
    return np.append((2 * asked - flown).clip(-ACTION_LIMIT, ACTION_LIMIT), np.clip(turn, -TURN, TURN))


class KnowsTheMap:
    """Flies the shortest way through the free space of the task's valley.

    Args:
        env: knows the map.
        narrow: times the length that a way counts through the narrowest place.
    """

    def __init__(self, env: NavigationEnv, narrow: float = NARROW) -> None:
        self.world = env.world
        places = env.world.places
        self.valleys = {each.seed: (each, Ways(free_space(each.config, each.scene), narrow)) for each in places}
        self._following: dict[int, np.ndarray] = {}  # of the tasks that are being flown

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action`` from the true positions."""
        keys = ("task", "world_seed", "position", "velocity", "goal", "attitude")
        told = [tensordict[key].double().numpy() for key in keys]
        actions = [self._action(int(task[0]), int(seed[0]), *rest) for task, seed, *rest in zip(*told, strict=True)]
        self._following = {int(task[0]): self._following[int(task[0])] for task in told[0]}
        return tensordict.set("action", torch.from_numpy(np.stack(actions)).float())

    def _action(
        self, task: int, seed: int, position: np.ndarray, velocity: np.ndarray, goal: np.ndarray, attitude: np.ndarray
    ) -> np.ndarray:
        valley, ways = self.valleys[seed]
        origin = np.append(valley.origin, 0.0)
        if task not in self._following:
            self._following[task] = ways.to(goal - origin, self.world.config.goal_radius)
        apart, wide = ways.towards(position - origin + LAG * velocity, self._following[task])
        return command(apart, wide, velocity, float(attitude[2]))


def flown(row: str, tasks: int, narrow: float = NARROW) -> dict[str, Any]:
    """What a row of the suite comes to."""
    chosen = [each.replace("valleys=", "env.world.seeds=") for each in scenarios("all")[row]]
    settings = validate(compose(*chosen, name="evaluate"), EvaluateConfig)
    own = {"blind": True, "measure_clearance": True, "num_uavs": settings.num_uavs, "seed": settings.seed}
    env = build({**settings.env, **own}, EnvBase)
    assert isinstance(env, NavigationEnv)
    flights = rollout_episodes(env, KnowsTheMap(env, narrow), tasks)
    env.close()
    arrived = [flight for flight in flights if flight.outcome == "arrived"]
    least = [math.ceil(CONTROL_RATE * (flight.straight or 0.0) / FASTEST) for flight in arrived]
    return {
        **wilson(len(arrived), tasks),
        "outcomes": "".join(LETTERS[flight.outcome] for flight in flights),
        "steps": float(np.mean([flight.steps for flight in arrived])),
        "longest": max(flight.steps for flight in arrived),
        "straight": float(np.mean(least)),
    }


def main() -> None:
    """Flies all rows and prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rows", nargs="+", default=list(ROWS))
    parser.add_argument("--tasks", type=int, default=500)
    parser.add_argument("--narrow", type=float, default=NARROW, help="times that a way counts in the narrowest place")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    args = parser.parse_args()
    torch.set_num_threads(1)
    found = {}
    print("| row | success, % (95 % CI) | steps of those | most | straight on |\n|---|---|---|---|---|")
    for row in args.rows:
        found[row] = flown(row, args.tasks, args.narrow)
        told = "{steps:.0f} | {longest} | {straight:.0f}".format(**found[row])
        print(f"| {row} | {rate_cell(found[row])} | {told} |", flush=True)
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
