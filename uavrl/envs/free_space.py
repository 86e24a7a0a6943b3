"""The free space of a valley: how far its points are from the geometry, and which of them a vehicle can reach."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from uavrl.envs.mesh import Mesh

SURFACE_STEP = 0.1  # m, edge of the triangles whose corners stand for the surface
SURFACE_ERROR = SURFACE_STEP / 3**0.5  # m, no point of a triangle is farther than this from its nearest corner


def surface_points(mesh: Mesh, low: float, high: float) -> np.ndarray:
    """Returns points ``[P, 3]``: the surface between two heights is nowhere over ``SURFACE_ERROR`` from one."""
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


def grid_points(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Returns the points ``[X, Y, Z, 3]`` of a grid with the axes ``x [X]``, ``y [Y]`` and ``z [Z]``."""
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), -1)


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
        ends = []
        for axis, grid in enumerate((self.x, self.y, self.z)):
            if len(grid) < 2:
                continue
            low, high = _neighbours(axis)
            free = allowed[low] & allowed[high]
            free &= self.clearance[low] + self.clearance[high] >= 2 * radius + (grid[1] - grid[0])
            ends.append(np.stack([index[low][free], index[high][free]]))
        first, second = np.concatenate(ends, axis=1) if ends else np.zeros((2, 0), int)
        graph = coo_array((np.ones(len(first)), (first, second)), (allowed.size, allowed.size))
        part = connected_components(graph, directed=False)[1].reshape(allowed.shape)
        inside = allowed & (self.clearance >= radius)
        if not inside.any():
            return inside
        return inside & (part == np.bincount(part[inside]).argmax())


def _neighbours(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of all points but the last, and of those that follow them, along one axis."""
    low, high = [slice(None)] * 3, [slice(None)] * 3
    low[axis], high[axis] = slice(None, -1), slice(1, None)
    return tuple(low), tuple(high)


class Surface:
    """The surface of a mesh between two heights as points, to measure clearances with."""

    def __init__(self, mesh: Mesh, low: float, high: float) -> None:
        self._tree = cKDTree(surface_points(mesh, low, high), balanced_tree=False, compact_nodes=False)

    def clearance(self, points: np.ndarray, longest: float) -> np.ndarray:
        """Returns a lower bound in metres of the distance of ``points [..., 3]`` to the surface, cut at ``longest``."""
        reach = longest + SURFACE_ERROR
        return self._tree.query(points, distance_upper_bound=reach)[0].clip(max=reach) - SURFACE_ERROR
