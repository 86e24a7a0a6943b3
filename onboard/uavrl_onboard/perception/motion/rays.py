"""Which rays of a scan count where it is looked for what moves: one firing cycle in five, a degree apart."""

from typing import NamedTuple

import numpy as np

from uavrl_onboard.geometry import Columns, is_return
from uavrl_onboard.perception.cells import AZIMUTH_STEP, FAR_EVERY
from uavrl_onboard.perception.motion.occlusion import Grid

FIRST = -0.1875  # of a step: where a cycle begins, whose 16 lasers fire within 0.625 of a step, in the middle of it
FINE = 0.9  # share of the fifths in which a sensor that turns ten times a second has points, where it has any around
WIDE = 60.0  # degrees between the lowest and the highest ray, from which on beams may lie 3 degrees apart
TERMS = (float(np.degrees(AZIMUTH_STEP)), FIRST, FAR_EVERY)
"""By which a point counts: the step in degrees, where the first one begins, and one of how many."""


class ScanPattern(NamedTuple):
    """How the rays of a LiDAR lie, as far as motion detection depends on it.

    A VLP-16 has a ray in each cell of the range images that are compared, so that a single one of the last four scans
    says what it saw in a direction. The rays of other LiDARs miss some cells, and two scans must agree. The beams of a
    LiDAR that looks far up and down lie farther apart, so its cells are coarser. So are those of a Livox, whose rays
    change from scan to scan: all its returns are searched, and three scans must agree.

    Args:
        lowest: elevation of the lowest ray, degrees.
        highest: of the highest one.
        repeats: whether each scan has the same rays.

    Examples:
        >>> [pattern.agreeing for pattern in (ScanPattern(), ScanPattern(-45, 45), ScanPattern(-7, 52, repeats=False))]
        [1, 2, 3]
    """

    lowest: float = -15.0
    highest: float = 15.0
    repeats: bool = True

    @property
    def grid(self) -> Grid:
        """The cells of the range images that are compared."""
        sparse = self.highest - self.lowest > WIDE
        return Grid.of_elevations(self.lowest, self.highest, coarse=sparse or not self.repeats)

    @property
    def agreeing(self) -> int:
        """How many earlier scans must have seen through where something moves now."""
        if not self.repeats:
            return 3
        return 1 if self.grid == Grid() else 2

    def searched(self, columns: Columns) -> np.ndarray:
        """Of the returns of a scan, the places of those that are searched for motion, ``[Q]``."""
        return far_rays_of(columns) if self.repeats else np.arange(columns.points.shape[1])


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
