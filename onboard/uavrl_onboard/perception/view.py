"""What the sensor of a policy's training could see: what another one sees besides, the policy has never read."""

from __future__ import annotations

import numpy as np

View = tuple[float, float, float, float]
"""The rightmost, leftmost, lowest and highest direction in degrees; 0 is ahead, left and up are positive.

The leftmost direction of a sensor that looks backwards is beyond 180.
"""
VLP16_VIEW: View = (-180.0, 180.0, -15.0, 15.0)
SLACK = 0.5  # degrees beside a field of view that still count, since sensors differ and angles are rounded


def in_view(x: np.ndarray, y: np.ndarray, z: np.ndarray, view: View) -> np.ndarray:
    """Return which points ``[M]`` lie in a field of view, or at most 0.5 degrees beside it: ``bool [M]``.

    Args:
        x: forward, in m from the sensor.
        y: left.
        z: up.
        view: in degrees.

    Examples:
        Of a point ahead, one 45 degrees above and one behind, a camera sees the first:

        >>> x, y, z = np.array([[2.0, 2.0, -2.0], [0.0, 0.0, 0.1], [0.0, 2.0, 0.0]])
        >>> in_view(x, y, z, (-45.0, 45.0, -15.0, 15.0)).tolist()
        [True, False, False]
        >>> in_view(x, y, z, (-180.0, 180.0, -15.0, 15.0)).tolist()
        [True, False, True]
        >>> in_view(x, y, z, (135.0, 225.0, -15.0, 15.0)).tolist()  # backwards
        [False, False, True]
    """
    right, left, low, high = view
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    seen = (elevation >= low - SLACK) & (elevation <= high + SLACK)
    if left - right + 2 * SLACK < 360.0:
        from_right = (np.degrees(np.arctan2(y, x)) - (right - SLACK)) % 360.0
        seen &= from_right <= left - right + 2 * SLACK
    return np.asarray(seen)


def is_view(view: View) -> bool:
    """Return whether four numbers are a field of view: each pair in order, and within the sphere."""
    right, left, low, high = view
    return -180.0 <= right <= 180.0 and right <= left <= right + 360.0 and -90.0 <= low <= high <= 90.0


def with_rows(view: View, elevation: tuple[float, float]) -> View:
    """Return a field of view with the elevations of a range image's rows, in degrees, in it, too.

    Examples:
        >>> with_rows((-180.0, 180.0, -15.0, 15.0), (-7.0, 52.0))
        (-180.0, 180.0, -15.0, 52.0)
    """
    right, left, low, high = view
    return right, left, min(low, elevation[0]), max(high, elevation[1])
