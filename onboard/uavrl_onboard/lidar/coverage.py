"""Whether scans cover what their sensor should see: a policy takes what it does not see for free."""

from __future__ import annotations

import math
from collections import deque
from typing import Literal, NamedTuple

import numpy as np

from uavrl_onboard.geometry import Columns

EMPTY = 10
"""Scans in a row without a return, 1 s at 10 Hz: at 2 m/s that is half of the 4 m that a policy sees."""
WATCHED = 20
"""Scans after which a direction without returns is judged, 2 s at 10 Hz."""
GONE = 10
"""Scans without a return from a sector that had some; a vehicle that brakes is not tilted for as long."""
UNSEEN = 30
"""Degrees of the horizon without a return, as in a turn of packets: two columns of a range image."""
LOST = 90
"""Degrees that no obstacle covers alone, so that they do not become empty at once in flight."""
JUDGED = 60
"""Returns of a scan from which on its directions are judged."""
TURNED = math.radians(20.0)
"""Yaw after which the borders of open terrain have moved in the sensor's frame, and those of a window have not."""
FARTHEST = 500.0
"""Median range that no LiDAR on a vehicle has, m: its driver's unit is another, as millimetres."""
ONE_RANGE = 10.0
"""Range in all directions from which on it is none that was measured, m; nearer ones are obstacles, not free space."""
PARTS = (2, 2)
"""How often, at least, a direction has near returns again in 20 scans where each holds a part of a turn, and for how
many scans in a row on average, at most: what a vehicle passes is seen once, and for long."""
LAYER = 1.0
"""Degrees of elevation within which all returns of a sensor with a single layer lie."""
LEVEL = 2.0
"""Degrees from the horizontal within which they are judged: steeper, the ground may be all that is in range."""
_ODD = 5  # scans in a row whose ranges cannot be
_SPREAD = (0.01, 5.0, 4)  # of one range: relative width; degrees of elevation and quarters of the horizon that have it
_PART = (30, 10)  # degrees of a direction, and near returns in it, for parts of a turn
_FLICKER = 0.75  # of the directions that ever have near returns
_EDGE = 3  # degrees within which a window's border is met in every scan
_ALIGNED = 1  # degrees between the border of a half or a quarter of the circle and the last return
_FILLED = 0.9  # of the directions outside a window that have returns
_SEEN_BEFORE = 8  # scans in a row in which a sector had returns before it lost them
_NEAR = 0.5  # of the farthest return: what was nearer than that has not gone out of a driver's range
_NEAR_SHARE = 0.25  # of a sector that must have been so near
_COARSE = 5  # degrees of the directions in which returns are counted
_ROUGH = 1e-3  # degrees by which an azimuth in single precision may be off, and more


class Doubt(NamedTuple):
    """What is wrong with some scans."""

    kind: Literal["empty_scans", "odd_ranges", "half_scan"]
    sentence: str
    certain: bool  #: whether nothing may be flown by them; else there is an innocent reason, too


class Coverage:
    """Looks at one scan after the other, with the points on the vehicle.

    Open terrain has no returns where nothing is in range, which is no fault. A window is certain where its borders
    stay in the sensor's frame while the vehicle turns, or lie at right angles to its axes; and a sector is certainly
    lost where near returns cease in all of it from one scan to the next. Ranges that nobody can have measured are
    certain, too, and so are scans of which each holds another part of a turn, and returns at one elevation alone.

    Args:
        sides: the right and the left border of the sensor's field of view in degrees; what lies beside it is never
            missed.
        elevations: its lowest and its highest ray in degrees; None where nobody says, and no elevation is missed.
        level: whether it looks equally far down on all sides. Where it does not, open ground is not seen on one side.

    Examples:
        >>> coverage, nothing = Coverage(), np.full((100, 3), np.nan)
        >>> [coverage.add(nothing) for _ in range(EMPTY)][-1].kind
        'empty_scans'
    """

    def __init__(
        self,
        sides: tuple[float, float] = (-180.0, 180.0),
        elevations: tuple[float, float] | None = None,
        level: bool = True,
    ) -> None:
        right, left = sides
        self._level = level
        self._elevations = elevations
        self._lowest, self._highest = math.inf, -math.inf  # sines of the elevations of all returns
        from_right = (np.arange(360) + 0.5 - right) % 360.0
        self._beside = (from_right < _EDGE) | (from_right > left - right - _EDGE)
        if left - right > 360.0 - _EDGE:
            self._beside[:] = False
        self._empty, self._odd, self._scans = 0, 0, 0
        self._near: deque[np.ndarray] = deque(maxlen=WATCHED)  # bool: wide directions that have near returns
        self._recent: deque[np.ndarray] = deque(maxlen=WATCHED)  # bool [360] each: degrees that have returns
        self._ever = np.zeros(360, bool)
        self._last = np.full(360 // _COARSE, -1)  # the latest scan with a return in each direction
        self._run = np.zeros(360 // _COARSE, int)  # in how many in a row it had one by then
        self._nearest = np.full(360 // _COARSE, np.inf)  # how near it was, m
        self._farthest = 0.0
        self._first_yaw: float | None = None
        self._turned = 0.0

    def add(self, points: np.ndarray, yaw: float | None = None) -> Doubt | None:
        """Take in a scan; return what is wrong with the latest ones.

        Args:
            points: ``[P, 3]`` in the sensor frame, m.
            yaw: of the vehicle, rad; None where nobody says.
        """
        return self.look(Columns.of(points), yaw)

    def look(self, columns: Columns, yaw: float | None = None) -> Doubt | None:
        """Do what :meth:`add` does with the returns of a scan."""
        self._empty = 0 if columns.squared.size else self._empty + 1
        if self._empty >= EMPTY:
            cause = "is the sensor covered, its laser off, or its driver's range too short?"
            return Doubt("empty_scans", f"{self._empty} scans in a row hold no return at all: {cause}", True)
        if columns.squared.size < JUDGED:
            return None
        odd = None if _differ(columns.squared) else _odd_ranges(np.ascontiguousarray(columns.points.T))
        self._odd = 0 if odd is None else self._odd + 1
        if odd is not None and self._odd >= _ODD:
            return Doubt("odd_ranges", odd, True)
        self._count(columns)
        if yaw is not None and math.isfinite(yaw):
            self._first_yaw = yaw if self._first_yaw is None else self._first_yaw
            self._turned = max(self._turned, abs(math.remainder(yaw - self._first_yaw, math.tau)))
        return self._layer(columns) or self._lost() or self._parts() or self._window()

    def _count(self, columns: Columns) -> None:
        """Take in the returns."""
        degree = degrees_of(columns)
        x, y = columns.points[:2].astype(np.float64)
        far = x * x + y * y  # squared
        least = np.full(360, np.inf)
        np.minimum.at(least, degree, far)
        seen = (least < np.inf) | self._beside
        self._recent.append(seen)
        self._ever |= seen
        coarse = seen.reshape(-1, _COARSE).any(1)
        self._run = np.where(coarse, np.where(self._last == self._scans - 1, self._run, 0) + 1, self._run)
        self._last[coarse] = self._scans
        self._nearest = np.where(coarse, np.sqrt(least.reshape(-1, _COARSE).min(1)), self._nearest)
        self._farthest = max(self._farthest, math.sqrt(far.max()))
        self._scans += 1
        wide, enough = _PART
        near = degree.take(np.flatnonzero(far < (_NEAR * self._farthest) ** 2))
        self._near.append(np.bincount(near, minlength=360).reshape(-1, wide).sum(1) >= enough)

    def _layer(self, columns: Columns) -> Doubt | None:
        """Returns at one elevation alone, of a sensor that should see several."""
        if self._elevations is None or self._elevations[1] - self._elevations[0] <= LAYER:
            return None
        if self._highest - self._lowest <= math.radians(LAYER):  # after that it has been answered for good
            sines = columns.points[2] / np.sqrt(columns.squared)
            self._lowest = min(self._lowest, float(sines.min()))
            self._highest = max(self._highest, float(sines.max()))
        level = math.sin(math.radians(LEVEL))
        spread = self._highest - self._lowest
        if self._scans < WATCHED or spread > math.radians(LAYER) or max(-self._lowest, self._highest) > level:
            return None
        should = "the sensor should see from {:g}° to {:g}°".format(*self._elevations)
        cause = "does its driver publish a single ring, or is it a 2-D LiDAR (hull.elevations=[0,0])?"
        return Doubt("half_scan", f"all returns lie at the same elevation, and {should}: {cause}", True)

    def _parts(self) -> Doubt | None:
        """Directions that have near returns in some scans and none in others, again and again."""
        near = np.array(self._near)
        ever = np.asarray(near.any(0))
        if len(near) < WATCHED or ever.mean() < 1 / 3:
            return None
        begins = (near & ~np.concatenate([np.zeros_like(near[:1]), near[:-1]])).sum(0)
        often, long = PARTS
        if ((begins >= often) & (near.sum(0) <= long * begins))[ever].mean() < _FLICKER:
            return None
        what = "each scan shows another part of the surroundings"
        cause = "does the driver publish a part of a turn in each message? Let it publish whole turns"
        return Doubt("half_scan", f"{what}: {cause}", True)

    def _lost(self) -> Doubt | None:
        """A sector that had returns, and has had none since one moment."""
        gone = (self._scans - 1 - self._last >= GONE) & (self._run >= _SEEN_BEFORE)
        start, length = _longest(gone)
        if length * _COARSE < LOST:
            return None
        sector = (start + np.arange(length)) % len(gone)
        at_once = np.ptp(self._last[sector]) <= 1
        if not at_once or np.quantile(self._nearest[sector], _NEAR_SHARE) > _NEAR * self._farthest:
            return None
        where = _between(start * _COARSE, length * _COARSE)
        since = self._scans - 1 - int(self._last[sector].max())
        cause = "is the sensor covered there, or has its driver's window changed?"
        return Doubt("half_scan", f"no return has come {where} for {since} scans, where there were some: {cause}", True)

    def _window(self) -> Doubt | None:
        """A sector that never had a return, with sharp borders."""
        start, length = _longest(~self._ever)
        if len(self._recent) < WATCHED or length < UNSEEN:
            return None
        outside = np.delete(np.roll(self._ever, -start), slice(0, length))
        whole = outside[: len(outside) // _COARSE * _COARSE].reshape(-1, _COARSE).any(1)
        before, after = (start - 1 - np.arange(_EDGE)) % 360, (start + length + np.arange(_EDGE)) % 360
        recent = np.array(self._recent)
        is_sharp = bool(recent[:, before].any(1).all() and recent[:, after].any(1).all())
        if not is_sharp or whole.mean() < _FILLED:
            return None
        aligned = all(abs(math.remainder(edge, 90)) <= _ALIGNED for edge in (start, start + length))
        certain = self._level and (aligned or self._turned >= TURNED)
        where = f"no return has ever come {_between(start, length)}"
        cause = "does the driver's window cut it off?"
        return Doubt("half_scan", f"{where}: {cause if certain else f'is nothing in range there, or {cause}'}", certain)


def degrees_of(columns: Columns) -> np.ndarray:
    """Return in which degree to the left each return lies, ``int [M]`` in [0, 360).

    Most azimuths say so in single precision, too; only those near a border are computed in double precision.
    """
    rough = columns.azimuths * -math.degrees(1.0)  # which are to the right
    degree = np.floor(rough).astype(np.int64)
    close = np.flatnonzero(np.abs(rough - np.rint(rough)) < _ROUGH)
    x, y = columns.points[:2].take(close, axis=1).astype(np.float64)
    degree[close] = np.floor(np.degrees(np.arctan2(y, x))).astype(np.int64)
    degree += 360 * (degree < 0)
    return degree


def _differ(squared: np.ndarray) -> bool:
    """Return whether some ranges, whose squares these are, are so different and so short that none is odd."""
    farthest, nearest = math.sqrt(squared.max()), math.sqrt(squared.min())
    return farthest < 0.99 * FARTHEST and farthest - nearest > 1.01 * _SPREAD[0] * farthest


def _odd_ranges(points: np.ndarray) -> str | None:
    """Say why nobody has measured these returns, where that is certain of one scan."""
    points = points.astype(np.float64)
    ranges = np.sqrt((points**2).sum(1))
    median = float(np.median(ranges))
    if median > FARTHEST:
        cause = "is its driver's unit millimetres? Points must be in metres"
        return f"half of the returns are farther than {median:,.0f} m, which no LiDAR measures: {cause}"
    width, high, quarters = _SPREAD
    if median < ONE_RANGE or np.ptp(ranges) > width * median:
        return None
    elevation = np.degrees(np.arcsin(np.clip(points[:, 2] / ranges, -1.0, 1.0)))
    around = len(np.unique(np.floor(np.arctan2(points[:, 1], points[:, 0]) / (math.pi / 2))))
    if np.ptp(elevation) < high or around < quarters:
        return None
    cause = "is the sensor covered, or does its driver write a fixed range where there is no return?"
    return f"all returns are {median:.1f} m away in every direction: {cause}"


def _longest(flags: np.ndarray) -> tuple[int, int]:
    """Where the longest run of true flags on a circle begins, and how many it has."""
    if flags.all() or not flags.any():
        return 0, int(flags.sum())
    turned = np.roll(flags, -int(np.argmin(flags)))  # which begins with a false one
    steps = np.diff(np.concatenate([turned, [False]]).astype(int))
    begins, ends = np.flatnonzero(steps == 1) + 1, np.flatnonzero(steps == -1) + 1
    longest = int(np.argmax(ends - begins))
    return int(begins[longest] + np.argmin(flags)) % len(flags), int((ends - begins)[longest])


def _between(start: int, length: int) -> str:
    return f"from {start}° to {(start + length) % 360}° (0° is ahead, 90° left)"
