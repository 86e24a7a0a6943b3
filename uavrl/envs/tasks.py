"""The free space of a valley, and the tasks in it that have a free corridor in three dimensions."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from uavrl.envs.mesh import edge_lengths
from uavrl.envs.terrain import FLOOR_AMPLITUDE, HeightField
from uavrl_onboard.geometry import heading_vector
from uavrl_onboard.mesh import Mesh

CELL = 0.25  # m, between two points of the map along x and y
RISE = 0.5  # m, between two points of the map along z
JITTER = CELL / 2**0.5  # m, farthest a start or goal is from its point of the map
SURFACE_STEP = 0.1  # m, edge of the triangles whose corners stand for the surface
SURFACE_ERROR = SURFACE_STEP / 3**0.5  # m, no point of a triangle is farther than this from its nearest corner


def surface_points(mesh: Mesh, low: float, high: float) -> np.ndarray:
    """Returns points ``[P, 3]``: the surface between two heights is nowhere over ``SURFACE_ERROR`` from one."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    corners = corners[(corners[..., 2].min(1) <= high) & (corners[..., 2].max(1) >= low)]
    parts = np.ceil(edge_lengths(corners).max(1) / SURFACE_STEP).astype(int)
    points = [np.zeros((0, 3))]
    for n in np.unique(parts):
        i, j = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
        weights = np.stack([i, j, n - i - j], -1) / n
        points.append((weights @ corners[parts == n]).reshape(-1, 3))
    found = np.concatenate(points)
    return found[(found[:, 2] >= low - SURFACE_ERROR) & (found[:, 2] <= high + SURFACE_ERROR)]


def grid_points(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Returns the points ``[X, Y, Z, 3]`` of a grid with the axes ``x [X]``, ``y [Y]`` and ``z [Z]``."""
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), -1)


class Surface:
    """The surface of a mesh between two heights as points, to measure clearances with."""

    def __init__(self, mesh: Mesh, low: float, high: float) -> None:
        self._tree = cKDTree(surface_points(mesh, low, high), balanced_tree=False, compact_nodes=False, leafsize=128)

    def clearance(self, points: np.ndarray, longest: float) -> np.ndarray:
        """Returns a lower bound in metres of the distance of ``points [..., 3]`` to the surface, cut at ``longest``."""
        reach = longest + SURFACE_ERROR
        return self._tree.query(points, distance_upper_bound=reach)[0].clip(max=reach) - SURFACE_ERROR


@dataclass(frozen=True)
class FreeSpace:
    """Clearances on a grid of points in a valley's frame."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    clearance: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """All points ``[X, Y, Z, 3]`` in metres."""
        return grid_points(self.x, self.y, self.z)

    def largest_part(self, allowed: np.ndarray, radius: float) -> np.ndarray:
        """Returns the largest part of the space between any two points of which a ball can fly: ``bool [X, Y, Z]``.

        Two neighbours h apart are joined by a straight line whose clearance is nowhere less than half of what is left
        when h is taken from the sum of theirs: the ball flies along it if that is at least its radius. This proves
        corridors in all three dimensions. The inside of a closed mesh is no part of the space around it.
        """
        index = np.arange(allowed.size).reshape(allowed.shape)
        ends = [np.zeros((2, 0), int)]
        for axis, grid in enumerate((self.x, self.y, self.z)):
            first, second = np.arange(len(grid) - 1), np.arange(1, len(grid))
            free = allowed.take(first, axis) & allowed.take(second, axis)
            if len(first):
                room = self.clearance.take(first, axis) + self.clearance.take(second, axis)
                free &= room >= 2 * radius + (grid[1] - grid[0])
            ends.append(np.stack([index.take(first, axis)[free], index.take(second, axis)[free]]))
        first, second = np.concatenate(ends, axis=1)
        graph = coo_array((np.ones(len(first)), (first, second)), (allowed.size, allowed.size))
        part = connected_components(graph, directed=False)[1].reshape(allowed.shape)
        inside = allowed & (self.clearance >= radius)
        return inside & (part == np.bincount(part[inside]).argmax()) if inside.any() else inside


@dataclass(frozen=True)
class Task:
    """One episode's start, yaw, goal and place."""

    start: np.ndarray
    yaw: float
    goal: np.ndarray
    place: int
    world_seed: int


@dataclass(frozen=True)
class FlightMap:
    """What a UAV can fly through in one valley, from the ground to the ceiling."""

    space: FreeSpace
    corridor: np.ndarray
    candidates: np.ndarray

    def at(self, level: float) -> int:
        """The layer of the map nearest to a height in m."""
        return int(np.abs(self.space.z - level).argmin())

    def area_at(self, level: float) -> float:
        """The area in m² that a vehicle can fly in at a height in m."""
        return float(self.corridor[:, :, self.at(level)].sum() * CELL**2)


def flight_map(
    floor: HeightField,
    solid: Mesh,
    *,
    size: tuple[float, float],
    level: float,
    ceiling: float,
    uav_radius: float,
    min_clearance: float,
    min_distance: float,
) -> FlightMap:
    """Maps a place's free space once: tasks are then drawn in microseconds and are solvable by construction."""
    needed = min_clearance + JITTER
    x, y = (np.arange(CELL / 2 - length / 2, length / 2, CELL) for length in size)
    z = level + RISE * np.arange(-((level + FLOOR_AMPLITUDE) // RISE), (ceiling + FLOOR_AMPLITUDE - level) // RISE + 1)
    reach = uav_radius + RISE / 2
    low, high = min(z[0] - reach, level - needed), max(z[-1] + reach, level + needed)
    surface = Surface(solid, low - SURFACE_ERROR, high + SURFACE_ERROR)
    points = grid_points(x, y, z)
    space = FreeSpace(x, y, z, surface.clearance(points, reach))
    below = floor.at(points[:, :, 0, :2].reshape(-1, 2)).reshape(len(x), len(y), 1)
    corridor = space.largest_part((z > below) & (z <= below + ceiling - CELL / 2), uav_radius)
    at_level = int(np.abs(z - level).argmin())
    places = points[:, :, at_level][corridor[:, :, at_level]]
    candidates = places[surface.clearance(places, needed) >= needed, :2]
    return FlightMap(space, corridor, candidates[_has_partner(candidates, min_distance + 2 * JITTER)])


def _has_partner(points: np.ndarray, distance: float) -> np.ndarray:
    """Returns which points ``[C, 2]`` have another one at least ``distance`` away: ``bool [C]``."""
    farthest = np.zeros(len(points))
    for angle in np.linspace(0, np.pi, 64, endpoint=False) if len(points) else ():
        along = points @ heading_vector(angle)
        for extreme in (points[along.argmax()], points[along.argmin()]):
            farthest = np.maximum(farthest, np.linalg.norm(points - extreme, axis=1))
    return farthest >= distance
