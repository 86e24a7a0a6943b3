"""The nearest obstacles around vehicles, one in each direction."""

import numpy as np

from uavrl_onboard.geometry import first_least

AZIMUTHS, ELEVATIONS = 45, 23  # of the polar histogram (Baumann 2018, section 3.1), 8 degrees each


def polar_histogram(points: np.ndarray, owners: np.ndarray, count: int) -> list[np.ndarray]:
    """The nearest point of each cell of a polar histogram around each of ``count`` vehicles, ``[P, 3]`` each.

    Source: Baumann (2018), section 3.1; it keeps the point itself and not its distance alone, so that the hull's width
    can be added exactly.

    Args:
        points: ``[M, 3]``, m from the vehicle.
        owners: ``[M]``, whose they are, in rising order.
        count: of the vehicles.

    Examples:
        >>> points = np.array([[2.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]])
        >>> [each.tolist() for each in polar_histogram(points, np.array([0, 0, 1]), 2)]
        [[[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]]
    """
    x, y, z = points.T
    ranges = np.sqrt((points * points).sum(1))
    azimuth = np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * AZIMUTHS).astype(np.int64) % AZIMUTHS
    rise = np.arcsin((z / np.maximum(ranges, 1e-6)).clip(-1, 1)) / np.pi + 0.5
    elevation = np.minimum((rise * ELEVATIONS).astype(np.int64), ELEVATIONS - 1)
    cell = (owners * AZIMUTHS + azimuth) * ELEVATIONS + elevation
    first = first_least(cell, ranges, count * AZIMUTHS * ELEVATIONS)
    return np.split(points[first], np.searchsorted(owners[first], np.arange(1, count)))
