"""Where a flight may start and end: a map of the valley's free space at flight level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from uavrl.envs.mesh import Mesh
from uavrl.envs.terrain import HeightField

CELL = 0.2  # m, side of a cell of the map
SURFACE_STEP = 0.1  # m, edge of the triangles whose corners stand for the surface
SURFACE_ERROR = SURFACE_STEP / 3**0.5  # m, no point of a triangle is farther than this from its nearest corner
JITTER = CELL / 2**0.5  # m, farthest a point of a cell is from the cell's middle


@dataclass(frozen=True)
class Task:
    """One flight to make.

    Args:
        start: ``[3]``, the UAV's first position in metres.
        yaw: Its first heading in rad, in [-π, π).
        goal: ``[3]`` in metres: the goal cylinder's axis at its mid-height.
        valley: Index of the valley in the world.
        world_seed: The valley's seed.
    """

    start: np.ndarray
    yaw: float
    goal: np.ndarray
    valley: int
    world_seed: int


@dataclass(frozen=True)
class FlightMap:
    """Free space of one valley at flight level, on a grid of cells in the valley's frame.

    Two neighbouring cells of ``corridor`` can be flown between in a straight line, because the clearance changes by at
    most half a cell on the way and the cells' clearance includes that. Any two cells of it are thus connected.

    Args:
        x: ``[X]``, the cells' middles in metres.
        y: ``[Y]``, likewise.
        clearance: ``[X, Y]``, a lower bound in metres of the distance to the geometry, cut at the longest asked for;
            negative inside it.
        corridor: ``[X, Y]``, true in the largest connected part that the UAV can fly.
        candidates: ``[C, 2]`` in metres: cells of the corridor in which a flight may start or end.
    """

    x: np.ndarray
    y: np.ndarray
    clearance: np.ndarray
    corridor: np.ndarray
    candidates: np.ndarray


def surface_points(mesh: Mesh, low: float, high: float) -> np.ndarray:
    """Returns points ``[P, 3]`` such that the surface between two heights is nowhere over ``SURFACE_ERROR`` from one.

    Args:
        mesh: Any triangles, in metres.
        low: Least height in metres.
        high: Greatest height in metres.

    Examples:
        >>> points = surface_points(Mesh(np.eye(3), np.array([[0, 1, 2]])), -1.0, 2.0)
        >>> len(points) == 16 * 17 // 2
        True
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    corners = corners[(corners[..., 2].min(1) <= high) & (corners[..., 2].max(1) >= low)]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(1)
    parts = np.ceil(longest / SURFACE_STEP).astype(int)
    points = [np.zeros((0, 3))]
    for n in np.unique(parts):
        i, j = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
        weights = np.stack([i, j, n - i - j], -1) / n
        points.append((weights @ corners[parts == n]).reshape(-1, 3))
    found = np.concatenate(points)
    margin = SURFACE_ERROR
    return found[(found[:, 2] >= low - margin) & (found[:, 2] <= high + margin)]


def enclosed(mesh: Mesh, level: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Returns where a horizontal plane lies inside closed meshes, by their winding number ``bool [X, Y]``.

    Args:
        mesh: Closed parts whose faces turn outwards; parts may overlap.
        level: The plane's height in metres.
        x: ``[X]`` in metres, ascending.
        y: ``[Y]`` in metres.

    Examples:
        >>> from uavrl.envs.shapes import icosphere
        >>> enclosed(icosphere(1), 0.01, np.array([-2.0, 0.0, 2.0]), np.array([0.013]))[:, 0].tolist()
        [False, True, False]
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    following = np.roll(corners, -1, axis=1)
    rises = (corners[..., 2] < level) & (following[..., 2] >= level)
    falls = (corners[..., 2] >= level) & (following[..., 2] < level)
    cut = rises.any(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (level - corners[..., 2]) / (following[..., 2] - corners[..., 2])
        points = corners[..., :2] + share[..., None] * (following - corners)[..., :2]
    entry, leave = points[cut][rises[cut]], points[cut][falls[cut]]
    crossed = (entry[:, None, 1] < y) != (leave[:, None, 1] < y)
    segment, row = np.nonzero(crossed)
    entry, leave = entry[segment], leave[segment]
    at = entry[:, 0] + (y[row] - entry[:, 1]) / (leave[:, 1] - entry[:, 1]) * (leave[:, 0] - entry[:, 0])
    turns = np.zeros((len(x) + 1, len(y)), dtype=int)
    np.add.at(turns, (np.searchsorted(x, at), row), np.where(leave[:, 1] > entry[:, 1], 1, -1))
    return (turns.sum(0) - turns.cumsum(0))[:-1] != 0


def clearance_map(ground: HeightField, obstacles: Mesh, level: float, longest: float) -> tuple[np.ndarray, ...]:
    """Returns the grid's x ``[X]``, y ``[Y]`` and a lower bound of each cell's clearance ``[X, Y]`` in metres.

    Args:
        ground: The valley's height field.
        obstacles: All its obstacles, closed meshes.
        level: The flight level in metres.
        longest: Clearances are cut here, in metres.

    Examples:
        >>> from uavrl.envs.shapes import icosphere
        >>> flat = HeightField(np.zeros((2, 2)), (10.0, 10.0))
        >>> x, y, clearance = clearance_map(flat, icosphere(2).translated((0.0, 0.0, 3.5)), 3.5, 2.0)
        >>> float(clearance[0, 0]), bool(clearance[25, 25] < 0)
        (2.0, True)
    """
    x, y = (np.arange(CELL / 2 - length / 2, length / 2, CELL) for length in ground.size)
    cells = np.stack(np.meshgrid(x, y, [level], indexing="ij"), -1).reshape(-1, 3)
    reach = longest + SURFACE_ERROR
    surface = Mesh.merge([*ground.tiles(), obstacles])
    tree = cKDTree(surface_points(surface, level - reach, level + reach), balanced_tree=False, compact_nodes=False)
    distance = tree.query(cells, distance_upper_bound=reach)[0].clip(max=reach) - SURFACE_ERROR
    buried = (ground.at(cells[:, :2]) >= level).reshape(len(x), len(y)) | enclosed(obstacles, level, x, y)
    return x, y, np.where(buried, -1.0, distance.reshape(len(x), len(y)))


def largest_part(free: np.ndarray) -> np.ndarray:
    """Returns the largest part of ``free [X, Y]`` whose cells are connected over their sides.

    Examples:
        >>> largest_part(np.array([[True, False, True], [True, False, False]])).tolist()
        [[True, False, False], [True, False, False]]
    """
    labels, _ = ndimage.label(free)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return free & (labels == sizes.argmax())


def flight_map(
    ground: HeightField, obstacles: Mesh, level: float, uav_radius: float, min_clearance: float, min_distance: float
) -> FlightMap:
    """Maps a valley's free space once, so that a task is drawn in microseconds and is solvable by construction.

    Args:
        ground: The valley's height field.
        obstacles: All its obstacles, closed meshes.
        level: The flight level in metres.
        uav_radius: Radius in metres of a ball around the UAV.
        min_clearance: Least clearance of starts and goals in metres.
        min_distance: Least horizontal distance from start to goal in metres.

    Examples:
        >>> from uavrl.envs.shapes import icosphere
        >>> flat = HeightField(np.zeros((2, 2)), (10.0, 10.0))
        >>> flight = flight_map(flat, icosphere(2).translated((0.0, 0.0, 3.5)), 3.5, 0.35, 1.5, 5.0)
        >>> bool(np.linalg.norm(flight.candidates, axis=1).min() > 2.5)
        True
    """
    needed = min_clearance + JITTER
    x, y, clearance = clearance_map(ground, obstacles, level, max(needed, uav_radius + CELL))
    corridor = largest_part(clearance >= uav_radius + CELL / 2)
    cells = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    candidates = cells[corridor & (clearance >= needed)]
    return FlightMap(x, y, clearance, corridor, candidates[_has_partner(candidates, min_distance + 2 * JITTER)])


def _has_partner(points: np.ndarray, distance: float) -> np.ndarray:
    """Returns which points ``[C, 2]`` have another one at least ``distance`` away: ``bool [C]``."""
    farthest = np.zeros(len(points))
    for angle in np.linspace(0, np.pi, 64, endpoint=False) if len(points) else ():
        along = points @ np.array([np.cos(angle), np.sin(angle)])
        for extreme in (points[along.argmax()], points[along.argmin()]):
            farthest = np.maximum(farthest, np.linalg.norm(points - extreme, axis=1))
    return farthest >= distance
