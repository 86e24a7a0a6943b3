"""The quickest way through a grid of what is known, and the point of it that a vehicle heads for."""

from __future__ import annotations

import math

import numpy as np

from uavrl_onboard.guards.map.grid import Slices, grid_graph
from uavrl_onboard.guards.map.lines import Obstacles
from uavrl_onboard.vehicle import VEHICLE

EDGE = 2.0  # m, free around all that is known: there a way leads around it
WIDE = 1.2  # m from the hull's middle to an obstacle, from which on a way counts once
TIGHT = 0.6  # m, nearer than which it counts SQUEEZED times; between both, up to 3 times
SQUEEZED = 10.0
ROOM = (0.5, 3.0, math.inf)  # m, by which a detour may be greater than expected, search by search
ROUNDING = 1e-9  # share by which sums of lengths may be off
SPARE = 0.5  # m, by which more obstacles are looked at than can be in the way
NEAREST = 1.0  # m, a point that is nearer is no direction
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
    return find_route(occupied, start, goal, cell, radius)[0]


def find_route(
    occupied: np.ndarray,
    start: np.ndarray,
    goal: np.ndarray,
    cell: float,
    radius: float = VEHICLE.radius,
    detour: float = 0.0,
) -> tuple[np.ndarray | None, float]:
    """Return the way of :func:`route` and its detour, by a search that is short where the detour is expected.

    No way with a smaller detour than is tried leaves the cells from whose middles the distances to both ends add up to
    no more than that allows. So only these are searched first, and all only where they hold no such way.

    Args:
        occupied: as in :func:`route`, as the next ones.
        start: ``[2]`` m.
        goal: ``[2]`` m.
        cell: edge, m.
        radius: of the hull, m.
        detour: m, by which the way is expected to count more than one in free air; infinity searches all cells.

    Returns:
        The way and its detour; None and 0 where no way is left.
    """
    ends = np.floor(np.stack([start, goal]) / cell).astype(np.int64)
    known = np.concatenate([occupied, ends])
    border = round(EDGE / cell)
    low, high = known.min(0) - border, known.max(0) + border
    free_air = cell * float(_steps(*np.abs(ends[0] - ends[1])))
    for more in ROOM:
        found = _search(occupied, ends, low, high, cell, radius, free_air + detour + more)
        if found is not None:
            cells, length = found
            return np.concatenate([start[None], cell * (cells + 0.5), goal[None]]), length - free_air
    return None, 0.0


def _search(
    occupied: np.ndarray, ends: np.ndarray, low: np.ndarray, high: np.ndarray, cell: float, radius: float, most: float
) -> tuple[np.ndarray, float] | None:
    """Return the cells ``[L, 2]`` between both ends of the quickest way, and what it counts; None for none up to most.

    Args:
        occupied: cells ``[K, 2]``.
        ends: the cells of start and goal, ``[2, 2]``.
        low: the first cell of the grid.
        high: the last one.
        cell: edge, m.
        radius: of the hull, m.
        most: what a way may count, m.
    """
    # Imported here, since SciPy loads in half a second and only a map needs it.
    from scipy.sparse.csgraph import dijkstra

    apart = np.abs(ends[0] - ends[1])
    if bounded := math.isfinite(most):
        beside = math.ceil((most / cell - float(_steps(*apart))) / (2 * (math.sqrt(2) - 1))) + 1
        low, high = np.maximum(low, ends.min(0) - beside), np.minimum(high, ends.max(0) + beside)
    shape = tuple((high - low + 1).tolist())
    clearance = cell * _cells_to_occupied(occupied, low, shape, math.ceil(max(WIDE, radius) / cell))
    cost = 1 + 2 * ((WIDE - clearance) / (WIDE - TIGHT)).clip(0, 1)
    cost = np.where(clearance < TIGHT, SQUEEZED, cost)
    free = clearance > radius
    here, there = (tuple(end) for end in ends - low)
    free[here] = free[there] = True
    if bounded:
        rows, columns = (np.abs(np.arange(size)[:, None] - (ends - low)[:, axis]) for axis, size in enumerate(shape))
        through = sum(_steps(rows[:, None, end], columns[None, :, end]) for end in (0, 1))
        free &= through <= most / cell * (1 + ROUNDING)

    def weighed(one: Slices, other: Slices, apart: float) -> tuple[np.ndarray, np.ndarray]:
        return free[one] & free[other], cell * apart / 2 * (cost[one] + cost[other])

    graph, index = grid_graph(shape, weighed)
    limits = {"limit": most * (1 + ROUNDING)} if bounded else {}
    begin, end = int(index[here]), int(index[there])
    counts, before = dijkstra(graph, indices=begin, return_predecessors=True, **limits)
    if math.isinf(counts[end]) or counts[end] > most:
        return None
    way = [end]
    while way[-1] != begin:
        way.append(int(before[way[-1]]))
    between = np.array(way[-2:0:-1], np.int64)
    return np.stack(np.unravel_index(between, shape), 1) + low, float(counts[end])


def _cells_to_occupied(occupied: np.ndarray, low: np.ndarray, shape: tuple[int, ...], beside: int) -> np.ndarray:
    """Return how many cells each of a grid is from the nearest occupied one, right up to ``beside``, else more."""
    from scipy.ndimage import distance_transform_edt

    inside = occupied - low + beside
    wide = np.array(shape) + 2 * beside
    inside = inside[((inside >= 0) & (inside < wide)).all(1)]
    if not len(inside):
        return np.full(shape, np.inf)
    space = np.ones(wide, bool)
    space[inside[:, 0], inside[:, 1]] = False
    distances: np.ndarray = distance_transform_edt(space)
    return distances[beside:-beside, beside:-beside]


def _steps(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return how long a way over so many rows and columns is in free air, in cells: straight and diagonal steps."""
    return np.maximum(rows, columns) + (math.sqrt(2) - 1) * np.minimum(rows, columns)


def waypoint(
    way: np.ndarray,
    place: np.ndarray,
    obstacles: np.ndarray,
    ahead: float,
    radius: float = VEHICLE.radius,
    *,
    closely: bool = False,
) -> tuple[int, bool]:
    """The last point of a way that is straight ahead, or else where the way bends within sight.

    Where the way bends, that point may lie behind a corner, which a vehicle that avoids obstacles flies around by
    itself. ``closely`` gives the last point before the corner instead, unless it is nearer than ``NEAREST``.

    Args:
        way: ``[L, 2]`` m.
        place: of the vehicle, ``[2]`` m, near the way.
        obstacles: ``[K, 2]`` m.
        ahead: how far the vehicle looks along the way, m.
        radius: of the hull, m; 0.35 by default.
        closely: whether a point that is straight ahead is preferred however near it is.

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
        >>> before = np.array([[1.5, 1.4]])
        >>> waypoint(corner, np.zeros(2), before, ahead=3.5), waypoint(corner, np.zeros(2), before, 3.5, closely=True)
        ((4, False), (3, True))
    """
    first = int(((way - place) ** 2).sum(1).argmin())
    left = way[first:]
    last = _last_free(Obstacles(_near(obstacles, place, left, radius), place, radius + SEEN_AROUND), place, left)
    enough = NEAREST if closely else ahead
    if last >= 0 and (last == len(left) - 1 or np.linalg.norm(left[last] - place) >= enough):
        return first + last, True
    gone = np.cumsum(np.linalg.norm(np.diff(left, axis=0, prepend=place[None]), axis=1))
    return first + min(int(np.searchsorted(gone, ahead)), len(left) - 1), False


def _near(obstacles: np.ndarray, place: np.ndarray, left: np.ndarray, radius: float) -> np.ndarray:
    """Return those obstacles that may come near a straight line from a place to any point of a way."""
    beside = radius + SEEN_AROUND + SPARE
    low, high = np.minimum(left.min(0), place) - beside, np.maximum(left.max(0), place) + beside
    (x, y), (left_end, bottom), (right_end, top) = obstacles.T, low, high
    return obstacles.take(np.flatnonzero((x > left_end) & (x < right_end) & (y > bottom) & (y < top)), axis=0)


def _last_free(around: Obstacles, place: np.ndarray, left: np.ndarray) -> int:
    """Return the last point of a way to which the straight line is free; -1 for none. Most often it is near the end."""
    end, some = len(left), 8
    while end > 0:
        begin = max(end - some, 0)
        tried = left[begin:end]
        free = np.flatnonzero(around.free(np.broadcast_to(place, tried.shape), tried))
        if len(free):
            return begin + int(free[-1])
        end, some = begin, 2 * some
    return -1
