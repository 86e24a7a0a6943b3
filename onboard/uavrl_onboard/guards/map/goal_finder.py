"""Where a goal is of which only directions are told."""

from __future__ import annotations

import numpy as np

GUESS = 15.0  # m, how far the goal is thought to be before its directions say
TRUST = 5e-3  # weight of that guess; n directions from places a metre apart, seen at d metres, have about n / d²


class GoalFinder:
    """Finds the goal where its directions from different places meet, by least squares.

    Args:
        farthest: m from the vehicle, at which a goal that is farther is put.

    Examples:
        A goal that was straight ahead, and lies to the right from 3 m to the left, is 4 m away:

        >>> finder = GoalFinder()
        >>> for _ in range(200):
        ...     _ = finder.look(np.array([0.0, 0.0]), np.array([1.0, 0.0]))
        ...     goal = finder.look(np.array([0.0, 3.0]), np.array([0.8, -0.6]))
        >>> bool(abs(goal - [4.0, 0.0]).max() < 0.05)
        True
    """

    def __init__(self, farthest: float = 40.0) -> None:
        self.farthest = farthest
        self._normals, self._offsets = np.zeros((2, 2)), np.zeros(2)
        self._guess: np.ndarray | None = None

    def look(self, place: np.ndarray, bearing: np.ndarray) -> np.ndarray:
        """Takes another direction in; returns where on it the goal is, as far as all so far say, ``[2]`` m.

        Args:
            place: of the vehicle, ``[2]`` m.
            bearing: unit vector ``[2]`` to the goal, same axes.
        """
        across = np.array([-bearing[1], bearing[0]])
        self._normals += np.outer(across, across)
        self._offsets += across * (across @ place)
        if self._guess is None:
            self._guess = place + GUESS * bearing
        met = np.linalg.solve(self._normals + TRUST * np.eye(2), self._offsets + TRUST * self._guess)
        return place + float(np.clip((met - place) @ bearing, 1.0, self.farthest)) * bearing
