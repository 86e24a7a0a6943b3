"""What one vehicle has seen since its episode began, as a grid at the flight level, and the ways through it."""

from __future__ import annotations

import numpy as np

from uavrl.mapping.route import route

GUESS = 15.0  # m, how far the goal is thought to be before its directions say
TRUST = 5e-3  # weight of that guess; n directions from places a metre apart, seen at d metres, have about n / d²


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
            self.occupied = _distinct(np.concatenate([self.occupied, np.floor(points / self.cell).astype(np.int64)]))
        near = np.abs((self.occupied + 0.5) * self.cell - place).max(1) < self.reach
        self.occupied = self.occupied[near]

    def middles(self) -> np.ndarray:
        """The middles of the cells in which something was seen, ``[K, 2]`` m since the episode's start."""
        return (self.occupied + 0.5) * self.cell

    def goal(self) -> np.ndarray:
        """Where the goal is, ``[2]`` m: in its present direction, as far as all its directions so far say."""
        assert self._guess is not None
        met = np.linalg.solve(self._normals + TRUST * np.eye(2), self._offsets + TRUST * self._guess)
        far = float(np.clip((met - self._place) @ self._bearing, 1.0, self.reach))
        return self._place + far * self._bearing

    def route(self) -> np.ndarray | None:
        """The quickest way to the goal, ``[L, 2]`` m since the episode's start; None for none."""
        return route(self.occupied, self._place, self.goal(), self.cell)


def _distinct(cells: np.ndarray) -> np.ndarray:
    """Cells ``int [K, 2]``, each once and in order; as one number each they are sorted five times as fast."""
    x, y = cells.T
    numbers = np.unique((x << 32) + (y + 2**31))
    return np.stack([numbers >> 32, (numbers & (2**32 - 1)) - 2**31], 1)
