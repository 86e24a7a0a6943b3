"""Routes of planes: over the wall, down between the obstacles, along the valley and out over another wall."""

from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from uavrl.envs.mesh import Mesh
from uavrl.envs.tasks import Surface, grid_points
from uavrl.errors import UavrlError

CELL = 0.5  # m, between two points of the map along x and y
RISE = 1.0  # m, between two points of the map along z
SLACK = 0.2  # m of clearance kept for what smoothing takes away
STEP = 0.25  # m between two points of a route
BEND = 1.0  # m, standard deviation of the smoothing
FLATNESS = np.array([1.0, 1.0, 2.0])  # a plane is at least twice as wide as high: heights count double in clearances
ATTEMPTS = 8  # searches for one route before the valley is called closed

# Along a level to the eight neighbours, and up or down by one level at 45°.
LEVEL_MOVES = ((1, 0, 0), (0, 1, 0), (1, 1, 0), (1, -1, 0))
CLIMBING_MOVES = ((2, 0, 1), (2, 0, -1), (0, 2, 1), (0, 2, -1))


class Airspace:
    """Where planes can fly in one valley, below its ceiling and above its walls."""

    def __init__(self, mesh: Mesh, size: tuple[float, float], top: float, radius: float) -> None:
        self.radius = radius
        self._surface = Surface(Mesh(mesh.vertices * FLATNESS, mesh.faces), -radius, 2 * top + radius)
        x, y = (np.arange(CELL / 2 - length / 2, length / 2, CELL) for length in size)
        self.points = grid_points(x, y, np.arange(RISE, top + RISE / 2, RISE))
        self.free = self.clears(self.points, radius + SLACK)
        index = np.arange(self.free.size).reshape(self.free.shape)
        self.border = [index[0, :, -1], index[-1, :, -1], index[:, 0, -1], index[:, -1, -1]]  # by edge
        self._ends = np.concatenate([self._moves(index, move) for move in (*LEVEL_MOVES, *CLIMBING_MOVES)], axis=1)

    def clears(self, points: np.ndarray, radius: float) -> np.ndarray:
        """Returns where a flat ellipsoid at ``points [..., 3]``, ``radius`` wide and half as high, meets nothing."""
        return self._surface.clearance(points * FLATNESS, radius) >= radius - 1e-9

    def _moves(self, index: np.ndarray, move: tuple[int, ...]) -> np.ndarray:
        """Pairs ``[2, M]`` of free points that one move joins."""
        low = tuple(slice(max(0, -step), min(0, -step) or None) for step in move)
        high = tuple(slice(max(0, step), min(0, step) or None) for step in move)
        both = self.free[low] & self.free[high]
        return np.stack([index[low][both], index[high][both]])

    def graph(self, rng: np.random.Generator, level: float, ceiling: float) -> csr_array:
        """Costs of all moves for a plane that likes a level: it dives to it between the obstacles."""
        first, second = self._ends
        points = self.points.reshape(-1, 3)
        length = np.linalg.norm(points[first] - points[second], axis=1)
        z = (points[first, 2] + points[second, 2]) / 2
        whim = np.exp(rng.normal(0.0, 0.7, len(points)))
        cost = length * (0.2 + np.abs(z - level) + 3.0 * (z > ceiling)) * (whim[first] + whim[second])
        return coo_array((cost, (first, second)), (len(points), len(points))).tocsr()


def plan_routes(
    rng: np.random.Generator,
    mesh: Mesh,
    size: tuple[float, float],
    top: float,
    ceiling: float,
    radius: float,
    count: int,
) -> list[np.ndarray]:
    """Ways for planes that keep clear of a valley's geometry, ``[P, 4]`` each: x, y, z in metres and yaw in rad."""
    airspace = Airspace(mesh, size, top, radius)
    routes: list[np.ndarray] = []
    levels = rng.permutation(np.linspace(radius / 2, ceiling, count))
    for level in levels:
        for _ in range(ATTEMPTS):
            route = _search(rng, airspace, level, ceiling)
            if route is not None:
                routes.append(route)
                break
    if not routes:
        raise UavrlError(
            f"Planes need a way through the valley with {radius:.2f} m to all sides, and there is none; "
            "lower plane_wingspan, obstacles or obstacle_scale."
        )
    return routes


def _search(rng: np.random.Generator, airspace: Airspace, level: float, ceiling: float) -> np.ndarray | None:
    """One route from edge to edge by two places inside, or None where there is none or smoothing spoils it."""
    first, last = rng.permutation(4)[:2]
    inside = np.flatnonzero(airspace.free & (airspace.points[..., 2] < ceiling))
    if len(inside) < 2:
        return None
    stops = [rng.choice(airspace.border[first]), *rng.choice(inside, 2), rng.choice(airspace.border[last])]
    graph = airspace.graph(rng, level, ceiling)
    nodes = [stops[0]]
    for start, end in pairwise(stops):
        costs, before = dijkstra(graph, directed=False, indices=end, return_predecessors=True)
        if not np.isfinite(costs[start]):
            return None
        while nodes[-1] != end:
            nodes.append(before[nodes[-1]])
    route = smoothed(airspace.points.reshape(-1, 3)[nodes])
    below = (route[:, 2] < ceiling).mean()
    return route if below > 0.4 and airspace.clears(route[:, :3], airspace.radius).all() else None


def smoothed(corners: np.ndarray) -> np.ndarray:
    """Returns a polyline ``[C, 3]`` as points ``STEP`` apart with rounded bends, and their yaws: ``[P, 4]``."""
    fine = _resampled(corners, STEP)
    points = _resampled(gaussian_filter1d(fine, BEND / STEP, axis=0, mode="nearest"), STEP)
    ahead = np.gradient(points, axis=0)
    return np.column_stack([points, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))])


def _resampled(points: np.ndarray, step: float) -> np.ndarray:
    """Points ``step`` apart, or a little less, along a polyline."""
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    places = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / step)) + 1)
    return np.stack([np.interp(places, along, axis) for axis in points.T], -1)
