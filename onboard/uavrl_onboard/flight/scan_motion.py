"""Whether scans move as the pose says: a sensor or an estimator with wrong axes is fresh and finite, too."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.geometry import body_to_world, is_return, world_to_yaw, yaw_to_world

EVERY = 0.19
"""Time between two scans that are kept, s."""
APART = (0.95, 1.3)
"""Ages of the scan that one is compared with, s: in a second a vehicle moves by more than what is tolerated."""
HALF_HEIGHT = 0.5
"""Half the height of the slice at the sensor's height, m: above the ground, whose rings move with the sensor."""
REACH, NEAREST = 12.0, 0.6
"""Horizontal distances within which returns are compared, m."""
CELL = 0.3
"""Size of a cell of the slice, m."""
FEWEST = 15
"""Cells of the slice with a return from which on it is compared."""
MOST = 100
"""Cells that are compared."""
TOLERATED, OTHER = (0.6, 0.2), (1.0, 0.4)
"""Differences from what the pose says, in m and rad, that are tolerated, and from which on it is another motion."""
SHIFTS, TURNS = 2 * np.arange(-5, 6), 0.2 * np.arange(-3, 4)
"""Shifts along each axis, in cells, and turns, rad, beside those of the pose, that are tried."""
FARTHEST = 9.0
"""Distance between two scans up to which they are compared, m: they must show the same things."""
FITS, BETTER = 0.7, 0.3
"""Share of the returns that lie on each other under another motion, and by how much that is more than by the pose."""
AGREES = 0.6
"""Share from which on scans move as the pose says."""
LOOKED_AT, AGAINST = 4, 3
"""Comparisons that count, and how many of them must be against the pose."""
_MOVED = (0.5, 0.3)  # m and rad: a vehicle that stands agrees with any sensor
_STANDS = 0.3  # m
_ENOUGH = 8000  # points of a scan that are looked at, of those at all heights
_SIZE = 2 * math.ceil((REACH + FARTHEST) / CELL + SHIFTS.max() + 2)  # cells of an image along each axis
_GRID = np.stack(np.meshgrid(SHIFTS, SHIFTS, indexing="ij"), -1).reshape(-1, 2)
_AROUND = np.array([[0, 0], [2, 0], [-2, 0], [0, 2], [0, -2]])  # cells, within TOLERATED


class _Slice(NamedTuple):
    stamp: float
    position: np.ndarray  # of the vehicle, m
    yaw: float
    points: np.ndarray  # [n, 2] in the axes of the yaw, m, one in each cell with a return


class Displacement(NamedTuple):
    """How a vehicle moved from one scan to another, in the axes of the yaw at the first one."""

    forward: float  #: m
    left: float  #: m
    turn: float  #: to the left, rad

    @property
    def distance(self) -> float:
        """How far, m."""
        return math.hypot(self.forward, self.left)

    def __str__(self) -> str:
        """Its distance, its direction and its turn."""
        if self.distance < _STANDS:
            return f"turned by {math.degrees(self.turn):.0f}°" if abs(self.turn) >= _MOVED[1] else "stood"
        towards = math.degrees(math.atan2(self.left, self.forward)) % 360.0
        return f"moved by {self.distance:.1f} m towards {towards:.0f}° and turned by {math.degrees(self.turn):.0f}°"


class ScanMotion:
    """Compares each scan with one a second before, laid over it as the pose has moved, and in other ways.

    Walls and trunks stand still in the world. Where they lie on each other much better under another motion than under
    that of the pose, three times of four, sensor or pose is wrong: one repeats itself, is turned or mirrored, or has
    another unit. It is over when scans have moved as the pose says, three times in a row, while the vehicle moved.

    Examples:
        >>> check = ScanMotion()
        >>> check.add(np.zeros((0, 3)), Pose(0.0, (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), 0.0)) is None
        True
    """

    def __init__(self) -> None:
        self._kept: deque[_Slice] = deque(maxlen=1 + math.ceil(APART[1] / EVERY))
        self._against: deque[bool] = deque(maxlen=LOOKED_AT)
        self._agreed = 0  # comparisons in a row in which a moving vehicle moved as its pose says
        self.sentence: str | None = None

    def start_anew(self) -> None:
        """Drop the scans in axes that are others now."""
        self._kept.clear()

    def add(self, points: np.ndarray, pose: Pose | None) -> str | None:
        """Take in a scan; return why sensor or pose is wrong.

        Args:
            points: ``[P, 3]`` in the sensor frame without those on the vehicle, m.
            pose: at the time of the scan.
        """
        if pose is None or not np.isfinite([pose.stamp, *pose.position, pose.yaw]).all():
            return self.sentence
        if self._kept and 0.0 <= pose.stamp - self._kept[-1].stamp < EVERY:
            return self.sentence
        now = _Slice(pose.stamp, np.array(pose.position), pose.yaw, _slice(points, pose))
        self._kept.append(now)
        for before in reversed(self._kept):
            if APART[0] <= now.stamp - before.stamp <= APART[1]:
                self._compare(before, now)
                break
        return self.sentence

    def _compare(self, before: _Slice, now: _Slice) -> None:
        shift = now.position - before.position
        if len(before.points) < FEWEST or abs(shift[2]) > HALF_HEIGHT or np.linalg.norm(shift) > FARTHEST:
            return
        forward, left = world_to_yaw(shift[:2], before.yaw).tolist()
        told = Displacement(forward, left, math.remainder(now.yaw - before.yaw, math.tau))
        share, other, found = _shares(before.points, now.points, told)
        is_against = other >= FITS and share <= other - BETTER
        if is_against or share >= AGREES:
            self._against.append(is_against)
            moves = told.distance >= _MOVED[0] or abs(told.turn) >= _MOVED[1]
            self._agreed = 0 if is_against else self._agreed + moves
        if sum(self._against) >= AGAINST:
            self.sentence, self._agreed = _why(told, found, now.stamp - before.stamp), 0
            self._against.clear()
        elif self._agreed >= AGAINST:
            self.sentence = None


def _slice(points: np.ndarray, pose: Pose) -> np.ndarray:
    """Return the level slice of a scan at the sensor's height, ``[n, 2]`` in the axes of the yaw: one point a cell."""
    points = points[:: max(len(points) // _ENOUGH, 1)].astype(np.float64)
    points = points[is_return(points)]
    tilted = math.isfinite(pose.roll) and math.isfinite(pose.pitch)
    level = points @ body_to_world(np.array([[pose.roll, pose.pitch, 0.0]]))[0].T if tilted else points
    far = (level[:, :2] ** 2).sum(1)
    level = level[(np.abs(level[:, 2]) < HALF_HEIGHT) & (far > NEAREST**2) & (far < REACH**2), :2]
    first = np.unique(_index(level), return_index=True)[1]
    return level[np.sort(first)]


def _index(points: np.ndarray) -> np.ndarray:
    """Return the number of the cell of each of points ``[n, 2]`` in an image."""
    cells = np.floor(points / CELL).astype(np.int64) + _SIZE // 2
    index: np.ndarray = cells[:, 0] * _SIZE + cells[:, 1]
    return index


def _shares(before: np.ndarray, now: np.ndarray, told: Displacement) -> tuple[float, float, Displacement]:
    """Return which share of the earlier returns lies on later ones as the pose moved, the best otherwise, and how.

    Where the former is so great that no other motion can be better, none is tried.
    """
    near, before = _near(now), before[:: math.ceil(len(before) / MOST)]
    share, other, found = 0.0, 0.0, told
    for turn in (told.turn + TOLERATED[1] * np.arange(-1, 2)).tolist():
        shifts = _rounded(told, turn) + _AROUND
        share = max(share, float(_laid(before, near, shifts, turn).max()))
    if share > 1.0 - BETTER:
        return share, 0.0, told
    for turn in {0.0, -told.turn, *(told.turn + TURNS).tolist()}:
        expected = _rounded(told, turn)
        shifts = np.concatenate([_GRID, expected + _GRID])
        turned = abs(math.remainder(turn - told.turn, math.tau))
        is_other = (CELL * np.linalg.norm(shifts - expected, axis=1) >= OTHER[0]) | (turned >= OTHER[1])
        shares = _laid(before, near, shifts, turn) * is_other
        if shares.max() > other:
            best = int(shares.argmax())
            forward, left = yaw_to_world(CELL * shifts[best], turn).tolist()
            other, found = float(shares[best]), Displacement(forward, left, turn)
    return share, other, found


def _rounded(told: Displacement, turn: float) -> np.ndarray:
    """Return the shift of a motion in the axes after a turn, in whole cells."""
    shift = world_to_yaw(np.array([told.forward, told.left]), turn)
    return np.round(shift / CELL).astype(np.int64)


def _near(points: np.ndarray) -> np.ndarray:
    """Return an image ``bool [_SIZE * _SIZE]`` of the cells that hold a point or lie next to one that does."""
    image = np.zeros((_SIZE, _SIZE), bool)
    image.ravel()[_index(points)] = True
    near = np.zeros_like(image)
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            near[1:-1, 1:-1] |= image[1 + x : _SIZE - 1 + x, 1 + y : _SIZE - 1 + y]
    return near.ravel()


def _laid(points: np.ndarray, near: np.ndarray, shifts: np.ndarray, turn: float) -> np.ndarray:
    """Return which share of points ``[n, 2]`` lies near later ones after a turn and each shift ``[m, 2]``."""
    at = _index(world_to_yaw(points, np.full(len(points), turn)))
    shares: np.ndarray = near[at[None] - (shifts[:, 0] * _SIZE + shifts[:, 1])[:, None]].mean(1)
    return shares


def _why(told: Displacement, found: Displacement, seconds: float) -> str:
    what = f"in {seconds:.1f} s the vehicle {told} by its pose, and {found} by its scans"
    if found.distance < _STANDS and abs(found.turn) < _MOVED[1]:
        return f"{what}: does the LiDAR's driver repeat a scan, or is it a recording?"
    if told.distance < _STANDS and abs(told.turn) < _MOVED[1]:
        return f"{what}: does the autopilot's estimator run?"
    return f"{what}: look at how the LiDAR is mounted, at its driver's axes and unit, and at the compass"
