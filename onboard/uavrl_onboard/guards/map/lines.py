"""Straight lines between points, and how near they come to obstacles."""

from __future__ import annotations

import numpy as np


def clearances(points: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """How near each of ``points [P, D]`` is to each straight line from ``starts [S, D]`` to ``ends``: ``[S, P]`` m.

    Examples:
        >>> clearances(np.array([[1.0, 0.5, 0.0], [3.0, 0.0, 0.0]]), np.zeros((1, 3)), np.array([[2.0, 0.0, 0.0]]))
        array([[0.5, 1. ]])
    """
    ways = ends - starts
    squared, along = (ways * ways).sum(1)[:, None], ways @ points.T - (ways * starts).sum(1)[:, None]
    share = (along / np.maximum(squared, 1e-12)).clip(0, 1)
    apart = (points * points).sum(1) - 2 * starts @ points.T + (starts * starts).sum(1)[:, None]
    return np.sqrt((apart + share * (share * squared - 2 * along)).clip(0))


class Obstacles:
    """What stands around one vehicle, on a plane or in space, where the hull is a ball.

    What is already nearer to ``start`` than is kept is not to come nearer, so that a way out is found.

    Args:
        points: ``[P, D]``, m.
        start: where ways begin, ``[D]`` m.
        kept: between the hull's middle and a point, m.
    """

    def __init__(self, points: np.ndarray, start: np.ndarray, kept: float) -> None:
        self.points = points
        self.kept = np.minimum(kept, 0.99 * np.sqrt(((points - start) ** 2).sum(1)))

    def free(self, starts: np.ndarray, ends: np.ndarray, share: float = 1.0) -> np.ndarray:
        """Which straight lines ``[S, D]`` keep so great a share of the distance to all: ``bool [S]``."""
        return (clearances(self.points, starts, ends) > share * self.kept).all(1)
