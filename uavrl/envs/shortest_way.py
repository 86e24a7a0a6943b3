"""The shortest paths to the goals through the true free space, for demonstrators and critics."""

from __future__ import annotations

import numpy as np

from uavrl.envs.level_map import LevelMap, Ways
from uavrl.envs.world import World
from uavrl_onboard.geometry import world_to_yaw

AHEAD = 8  # cells of 0.25 m along the path to the point that a vehicle heads for: 2 m straight, 2.8 m diagonally
COMFORT = 1.0  # m from where the vehicle no longer fits, within which cells cost more
CROWDED = 2.0  # additional cost of a cell next to that, as a multiple of its length


class ShortestWays:
    """The shortest paths of all vehicles at the flight level, each to its own goal, around static obstacles.

    Planes are ignored.

    Args:
        world: Where they fly.
        vehicles: How many there are.
    """

    def __init__(self, world: World, vehicles: int) -> None:
        self._world = world
        self._maps: dict[int, LevelMap] = {}
        self._goals = np.zeros((vehicles, 2))
        self._ways: list[tuple[LevelMap, Ways] | None] = [None] * vehicles

    def begin(self, vehicle: int, place: int, goal: np.ndarray) -> None:
        """Computes the paths to a vehicle's goal, ``[2]`` or more numbers in m, which takes some milliseconds."""
        if place not in self._maps:
            self._maps[place] = LevelMap(self._world.places[place], comfort=COMFORT, crowded=CROWDED)
        level = self._maps[place]
        self._goals[vehicle] = goal[:2]
        self._ways[vehicle] = level, level.ways_to(level.fitting_cell(goal))

    def directions(self, positions: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        """Unit vectors ``[N, 2]``, forward and left, to the points ahead on the paths from ``positions [N, 3]``."""
        found = np.zeros((len(positions), 3))
        for vehicle, position in enumerate(positions):
            found[vehicle, :2] = self._point_ahead(vehicle, position) - position[:2]
        found = world_to_yaw(found, yaw)[:, :2]
        return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9))

    def _point_ahead(self, vehicle: int, position: np.ndarray) -> np.ndarray:
        """The point ``[2]`` ahead on a vehicle's path, or its goal if that is nearer or no path is known."""
        known = self._ways[vehicle]
        if known is None:
            return self._goals[vehicle]
        level, ways = known
        cell = int(level.number(level.fitting_cell(position)))
        for _ in range(AHEAD):
            if ways.ahead[cell] < 0:
                return self._goals[vehicle]
            cell = int(ways.ahead[cell])
        return np.asarray(level.middle(np.array(cell)))
