"""Where a flight may start and end: tasks that have a free corridor in three dimensions."""

from dataclasses import dataclass

import numpy as np

from uavrl.envs.free_space import FreeSpace, Surface, grid_points
from uavrl.envs.mesh import Mesh
from uavrl.envs.terrain import FLOOR_AMPLITUDE, HeightField

CELL = 0.25  # m, between two points of the map along x and y
RISE = 0.5  # m, between two points of the map along z
JITTER = CELL / 2**0.5  # m, farthest a start or goal is from its point of the map


@dataclass(frozen=True)
class Task:
    """One flight to make."""

    start: np.ndarray
    yaw: float
    goal: np.ndarray
    valley: int
    world_seed: int


@dataclass(frozen=True)
class FlightMap:
    """What a UAV can fly through in one valley, from the ground to the ceiling."""

    space: FreeSpace
    corridor: np.ndarray
    candidates: np.ndarray


def flight_map(
    ground: HeightField,
    obstacles: Mesh,
    *,
    level: float,
    ceiling: float,
    uav_radius: float,
    min_clearance: float,
    min_distance: float,
) -> FlightMap:
    """Maps a valley's free space once, so that a task is drawn in microseconds and is solvable by construction."""
    needed = min_clearance + JITTER
    x, y = (np.arange(CELL / 2 - length / 2, length / 2, CELL) for length in ground.size)
    z = level + RISE * np.arange(-((level + FLOOR_AMPLITUDE) // RISE), (ceiling + FLOOR_AMPLITUDE - level) // RISE + 1)
    surface = Surface(Mesh.merge([*ground.tiles(), obstacles]), z[0] - needed, z[-1] + needed)
    points = grid_points(x, y, z)
    space = FreeSpace(x, y, z, surface.clearance(points, uav_radius + RISE / 2))
    below = ground.at(points[:, :, 0, :2].reshape(-1, 2)).reshape(len(x), len(y), 1)
    corridor = space.largest_part((z > below) & (z <= below + ceiling - CELL / 2), uav_radius)
    at_level = int(np.abs(z - level).argmin())
    places = points[:, :, at_level][corridor[:, :, at_level]]
    candidates = places[surface.clearance(places, needed) >= needed, :2]
    return FlightMap(space, corridor, candidates[_has_partner(candidates, min_distance + 2 * JITTER)])


def _has_partner(points: np.ndarray, distance: float) -> np.ndarray:
    """Returns which points ``[C, 2]`` have another one at least ``distance`` away: ``bool [C]``."""
    farthest = np.zeros(len(points))
    for angle in np.linspace(0, np.pi, 64, endpoint=False) if len(points) else ():
        along = points @ np.array([np.cos(angle), np.sin(angle)])
        for extreme in (points[along.argmax()], points[along.argmin()]):
            farthest = np.maximum(farthest, np.linalg.norm(points - extreme, axis=1))
    return farthest >= distance
