"""Which rays of a scan count where it is looked for what moves: one firing cycle in five, a degree apart."""

import numpy as np

from uavrl_onboard.geometry import Columns, is_return
from uavrl_onboard.perception.cells import AZIMUTH_STEP, FAR_EVERY

FIRST = -0.1875  # of a step: where a cycle begins, whose 16 lasers fire within 0.625 of a step, in the middle of it
FINE = 0.9  # share of the fifths in which a sensor that turns ten times a second has points, where it has any around
TERMS = (float(np.degrees(AZIMUTH_STEP)), FIRST, FAR_EVERY)
"""By which a point counts: the step in degrees, where the first one begins, and one of how many."""


def far_rays(points: np.ndarray) -> np.ndarray:
    """Of one scan's points in any order, those in every fifth firing cycle of a VLP-16, in the order of firing.

    A point is in cycle ``floor(a / AZIMUTH_STEP - FIRST)``, where ``a`` is its azimuth to the right in [0, 360°) from
    straight ahead. In the simulator these are the rays that look farther than the cells. Of a real sensor, which begins
    anywhere, they are as many. Where it turns faster, so that many such cycles are empty, the next one counts.

    Args:
        points: ``[P, 3]`` in m in the sensor frame.

    Returns:
        ``[Q, 3]``; misses are left out.

    Examples:
        >>> to_the_right = -np.radians([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2])[::-1]
        >>> points = np.stack([np.cos(to_the_right), np.sin(to_the_right), 0 * to_the_right], -1)
        >>> np.degrees(np.arctan2(far_rays(points)[:, 1], far_rays(points)[:, 0])).round(1).tolist()
        [-0.0, -1.0]
    """
    columns = Columns.of(points)
    return columns.rows(far_rays_of(columns))


def far_ray_indices(points: np.ndarray) -> np.ndarray:
    """Of points ``[P, 3]``, or the directions of a sensor's rays, the places of those that count, ``[Q]``."""
    return np.flatnonzero(is_return(points)).take(far_rays_of(Columns.of(points)))


def far_rays_of(columns: Columns) -> np.ndarray:
    """Of the returns of a scan, the places of those that count, ``[Q]``."""
    azimuth = columns.azimuths
    azimuth = azimuth + azimuth.dtype.type(2.0 * np.pi) * (azimuth < 0)  # and of -0 it makes 0
    cycle = np.floor(azimuth / AZIMUTH_STEP - FIRST).astype(np.int32)
    sector = (cycle + FAR_EVERY // 2) // FAR_EVERY
    kept = np.flatnonzero(cycle == FAR_EVERY * sector)
    count = sector.max(initial=0) + 1
    are_hit = np.count_nonzero(np.bincount(sector.take(kept), minlength=count))
    if are_hit < FINE * count and are_hit < FINE * np.count_nonzero(np.bincount(sector, minlength=count)):
        off, nearest = np.abs(cycle - FAR_EVERY * sector), np.full(count, FAR_EVERY, np.int32)
        np.minimum.at(nearest, sector, off)
        kept = np.flatnonzero(off == nearest.take(sector))
    return kept.take(np.argsort(azimuth.take(kept), kind="stable"))
