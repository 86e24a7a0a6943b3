"""The quickest way through a grid of what is known, and the point of it that a vehicle heads for."""

from __future__ import annotations

import numpy as np

from uavrl_onboard.guards.map.grid import Slices, grid_graph
from uavrl_onboard.guards.map.lines import Obstacles
from uavrl_onboard.vehicle import VEHICLE

EDGE = 2.0  # m, free around all that is known: there a way leads around it
WIDE = 1.2  # m from the hull's middle to an obstacle, from which on a way counts once
TIGHT = 0.6  # m, nearer than which it counts SQUEEZED times; between both, up to 3 times
SQUEEZED = 10.0
SEEN_AROUND = 0.6  # m that a straight line of the way keeps between hull and cells


def route(
    occupied: np.ndarray, start: np.ndarray, goal: np.ndarray, cell: float, radius: float = VEHICLE.radius
) -> np.ndarray | None:
    """The quickest way from cell to cell, in eight directions; what is not known to be occupied is free.

    It keeps from obstacles where there is room: what is near them counts more than once, and where the hull does not
    fit, to the width of a cell, there is none.

    Args:
        occupied: cells ``int [K, 2]``, in any order.
        start: ``[2]`` m.
        goal: likewise.
        cell: edge, m.
        radius: of the hull, m; 0.35 by default.

    Returns:
        The start, middles of cells, and the goal, ``[L, 2]`` m; None where no way is left.

    Examples:
        A wall across the way, from y = -1 m to 3 m, is passed at its near end:

        >>> wall = np.column_stack([np.full(16, 8), np.arange(-4, 12)])
        >>> way = route(wall, np.zeros(2), np.array([4.0, 0.0]), 0.25)
        >>> bool(way[:, 1].min() < -1.0), bool(way[:, 1].max() < 0.5)
        (True, True)
    """
    # Imported here, since SciPy loads in half a second and only a map needs it.
    from scipy.ndimage import distance_transform_edt
    from scipy.sparse.csgraph import dijkstra

    ends = np.floor(np.stack([start, goal]) / cell).astype(np.int64)
    known = np.concatenate([occupied, ends])
    low = known.min(0) - round(EDGE / cell)
    shape = known.max(0) - low + round(EDGE / cell) + 1
    space = np.ones(shape, bool)
    space[tuple((occupied - low).T)] = False
    clearance = distance_transform_edt(space) * cell if len(occupied) else np.full(shape, np.inf)
    cost = 1 + 2 * ((WIDE - clearance) / (WIDE - TIGHT)).clip(0, 1)
    cost = np.where(clearance < TIGHT, SQUEEZED, cost)
    free = clearance > radius
    here, there = (tuple(end) for end in ends - low)
    free[here] = free[there] = True

    def weighed(one: Slices, other: Slices, apart: float) -> tuple[np.ndarray, np.ndarray]:
        return free[one] & free[other], cell * apart / 2 * (cost[one] + cost[other])

    graph, index = grid_graph(free.shape, weighed)
    apart, before = dijkstra(graph.tocsr(), directed=False, indices=index[here], return_predecessors=True)
    at = int(index[there])
    if not np.isfinite(apart[at]):
        return None
    way = [at]
    while way[-1] != index[here]:
        way.append(int(before[way[-1]]))
    between = np.array(way[-2:0:-1], np.int64)
    middles = cell * (np.stack(np.unravel_index(between, shape), 1) + low + 0.5)
    return np.concatenate([start[None], middles, goal[None]])


def waypoint(
    way: np.ndarray, place: np.ndarray, obstacles: np.ndarray, ahead: float, radius: float = VEHICLE.radius
) -> tuple[int, bool]:
    """The last point of a way that is straight ahead, or else where the way bends within sight.

    Args:
        way: ``[L, 2]`` m.
        place: of the vehicle, ``[2]`` m, near the way.
        obstacles: ``[K, 2]`` m.
        ahead: how far the vehicle looks along the way, m.
        radius: of the hull, m; 0.35 by default.

    Returns:
        The point's place in the way, and whether it is straight ahead.

    Examples:
        >>> corner = np.array([[0.0, 0], [1, 0], [2, 0], [3, 0], [3, 1], [3, 2], [3, 3], [3, 4]])
        >>> waypoint(corner, np.zeros(2), np.zeros((0, 2)), ahead=2.0)
        (7, True)
        >>> waypoint(corner, np.zeros(2), np.array([[1.5, 1.4]]), ahead=2.0)
        (3, True)
        >>> waypoint(corner, np.zeros(2), np.array([[1.5, 0.5]]), ahead=2.0)
        (2, False)
    """
    first = int(((way - place) ** 2).sum(1).argmin())
    left = way[first:]
    free = Obstacles(obstacles, place, radius + SEEN_AROUND).free(np.broadcast_to(place, left.shape), left)
    last = int(free.nonzero()[0].max(initial=-1))
    if last >= 0 and (last == len(left) - 1 or np.linalg.norm(left[last] - place) >= ahead):
        return first + last, True
    gone = np.cumsum(np.linalg.norm(np.diff(left, axis=0, prepend=place[None]), axis=1))
    return first + min(int(np.searchsorted(gone, ahead)), len(left) - 1), False
