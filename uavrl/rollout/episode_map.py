"""What one vehicle has seen since its episode began, as a grid at the flight level, and the ways through it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from uavrl.rollout.remembered import HULL

EDGE = 2.0  # m, free around all that is known: there a way leads around it
WIDE = 1.2  # m from the hull's middle to an obstacle, from which on a way counts once
TIGHT = 0.6  # m, nearer than which it counts SQUEEZED times; between both, up to 3 times
SQUEEZED = 10.0
GUESS = 15.0  # m, how far the goal is thought to be before its directions say
TRUST = 5e-3  # weight of that guess; n directions from places a metre apart, seen at d metres, have about n / d²


def route(occupied: np.ndarray, start: np.ndarray, goal: np.ndarray, cell: float) -> np.ndarray | None:
    """The quickest way from cell to cell, in eight directions; what is not known to be occupied is free.

    It keeps from obstacles where there is room: what is near them counts more than once, and where the hull does not
    fit, to the width of a cell, there is none.

    Args:
        occupied: cells ``int [K, 2]``, in any order.
        start: ``[2]`` m.
        goal: likewise.
        cell: edge, m.

    Returns:
        The start, middles of cells, and the goal, ``[L, 2]`` m; None where no way is left.

    Examples:
        A wall across the way, from y = -1 m to 3 m, is passed at its near end:

        >>> wall = np.column_stack([np.full(16, 8), np.arange(-4, 12)])
        >>> way = route(wall, np.zeros(2), np.array([4.0, 0.0]), 0.25)
        >>> bool(way[:, 1].min() < -1.0), bool(way[:, 1].max() < 0.5)
        (True, True)
    """
    ends = np.floor(np.stack([start, goal]) / cell).astype(np.int64)
    known = np.concatenate([occupied, ends])
    low = known.min(0) - round(EDGE / cell)
    shape = known.max(0) - low + round(EDGE / cell) + 1
    space = np.ones(shape, bool)
    space[tuple((occupied - low).T)] = False
    clearance = distance_transform_edt(space) * cell if len(occupied) else np.full(shape, np.inf)
    cost = 1 + 2 * ((WIDE - clearance) / (WIDE - TIGHT)).clip(0, 1)
    cost = np.where(clearance < TIGHT, SQUEEZED, cost)
    free = clearance > HULL[0]
    here, there = (tuple(end) for end in ends - low)
    free[here] = free[there] = True
    index = np.arange(free.size).reshape(shape)
    first, second, lengths = [], [], []
    for i, j in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = (slice(None, -i or None), slice(max(-j, 0), -j if j > 0 else None))
        b = (slice(i, None), slice(max(j, 0), j if j < 0 else None))
        both = free[a] & free[b]
        first.append(index[a][both])
        second.append(index[b][both])
        lengths.append((cell * np.hypot(i, j) / 2 * (cost[a] + cost[b]))[both])
    edges = (np.concatenate(first), np.concatenate(second))
    graph = coo_array((np.concatenate(lengths), edges), (free.size, free.size)).tocsr()
    apart, before = dijkstra(graph, directed=False, indices=index[here], return_predecessors=True)
    at = int(index[there])
    if not np.isfinite(apart[at]):
        return None
    way = [at]
    while way[-1] != index[here]:
        way.append(int(before[way[-1]]))
    between = np.array(way[-2:0:-1], np.int64)
    middles = cell * (np.stack(np.unravel_index(between, shape), 1) + low + 0.5)
    return np.concatenate([start[None], middles, goal[None]])


class EpisodeMap:
    """The cells at the flight level in which one vehicle has seen something, and where its goal seems to be.

    Args:
        cell: edge of a cell, m.
        reach: m from the vehicle, beyond which cells are forgotten.

    Examples:
        A goal that was straight ahead, and lies to the right from 3 m to the left, is 4 m away:

        >>> seen = EpisodeMap()
        >>> for _ in range(200):
        ...     seen.look(np.zeros((0, 2)), np.array([0.0, 0.0]), np.array([1.0, 0.0]))
        ...     seen.look(np.zeros((0, 2)), np.array([0.0, 3.0]), np.array([0.8, -0.6]))
        >>> bool(abs(seen.goal() - [4.0, 0.0]).max() < 0.05)
        True
    """

    def __init__(self, cell: float = 0.25, reach: float = 40.0) -> None:
        self.cell, self.reach = cell, reach
        self.occupied = np.zeros((0, 2), np.int64)
        self._normals, self._offsets = np.zeros((2, 2)), np.zeros(2)
        self._guess: np.ndarray | None = None
        self._place, self._bearing = np.zeros((2, 2))

    def look(self, points: np.ndarray, place: np.ndarray, bearing: np.ndarray) -> None:
        """Takes in what is seen.

        Args:
            points: ``[P, 2]`` m since the episode's start, of what is at the flight level.
            place: of the vehicle, ``[2]``, likewise.
            bearing: unit vector ``[2]`` to the goal, world axes.
        """
        across = np.array([-bearing[1], bearing[0]])
        self._normals += np.outer(across, across)
        self._offsets += across * (across @ place)
        self._place, self._bearing = place, bearing
        if self._guess is None:
            self._guess = place + GUESS * bearing
        if len(points):
            cells = np.floor(points / self.cell).astype(np.int64)
            self.occupied = np.unique(np.concatenate([self.occupied, cells]), axis=0)
            near = np.abs((self.occupied + 0.5) * self.cell - place).max(1) < self.reach
            self.occupied = self.occupied[near]

    def goal(self) -> np.ndarray:
        """Where the goal is, ``[2]`` m: in its present direction, as far as all its directions so far say."""
        assert self._guess is not None
        met = np.linalg.solve(self._normals + TRUST * np.eye(2), self._offsets + TRUST * self._guess)
        far = float(np.clip((met - self._place) @ self._bearing, 1.0, self.reach))
        return self._place + far * self._bearing

    def route(self) -> np.ndarray | None:
        """The quickest way to the goal, ``[L, 2]`` m since the episode's start; None for none."""
        return route(self.occupied, self._place, self.goal(), self.cell)
