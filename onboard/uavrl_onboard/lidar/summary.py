"""What a sensor sees over some scans: how often, how much, how near in each direction."""

from __future__ import annotations

import numpy as np

from uavrl_onboard.geometry import is_return
from uavrl_onboard.lidar.scans import Scan

SECTORS = ("ahead", "ahead left", "left", "behind left", "behind", "behind right", "right", "ahead right")
"""Eight directions, each of 45 degrees around its middle."""


class ScanSummary:
    """Adds scans up, without keeping more than a few.

    Args:
        keep: how many scans are kept, spread over all.

    Attributes:
        scans: how many there were.
        nearest: ``[8]``, the least distance to a return in each of ``SECTORS`` in m, infinite where there was none.
        kept: some of the scans.

    Examples:
        >>> summary = ScanSummary()
        >>> summary.add(Scan(0.0, np.array([[0.0, 2.0, 0.0], [np.nan] * 3], np.float32), rays=4, misses=3))
        >>> summary.facts()
        {'scans': 1, 'rate_hz': None, 'points_median': 1.0, 'nearest_m': 2.0, 'misses': 0.75}
        >>> summary.sectors()
        {'left': 2.0}
    """

    def __init__(self, keep: int = 20) -> None:
        self.scans, self.nearest = 0, np.full(len(SECTORS), np.inf)
        self.kept: list[Scan] = []
        self._keep, self._every = keep, 1
        self._points: list[int] = []  # of each scan
        self._misses, self._rays = 0, 0
        self._first, self._last = 0.0, 0.0

    def add(self, scan: Scan) -> None:
        """Adds a scan."""
        points = scan.points[is_return(scan.points)]
        if self.scans == 0:
            self._first = scan.stamp
        self._last = scan.stamp
        self._points.append(len(points))
        self._misses, self._rays = self._misses + scan.misses, self._rays + scan.rays
        sector = np.round(np.arctan2(points[:, 1], points[:, 0]) / (np.pi / 4)).astype(int) % len(SECTORS)
        np.minimum.at(self.nearest, sector, np.sqrt((points**2).sum(-1)))
        if self.scans % self._every == 0:
            self.kept.append(scan)
            if len(self.kept) > self._keep:
                self.kept, self._every = self.kept[::2], 2 * self._every
        self.scans += 1

    def facts(self) -> dict[str, float | None]:
        """The numbers by name; None where there is none."""
        span, nearest = self._last - self._first, float(self.nearest.min())
        return {
            "scans": self.scans,
            "rate_hz": (self.scans - 1) / span if span > 0 else None,
            "points_median": float(np.median(self._points)) if self._points else None,
            "nearest_m": round(nearest, 4) if np.isfinite(nearest) else None,
            "misses": self._misses / self._rays if self._rays else None,
        }

    def sectors(self) -> dict[str, float]:
        """The least distance to a return in each direction that has one, in m."""
        return {name: round(float(far), 4) for name, far in zip(SECTORS, self.nearest, strict=True) if np.isfinite(far)}
