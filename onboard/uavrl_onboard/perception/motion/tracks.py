"""Bodies that move straight on, followed from scan to scan by a Kalman filter."""

import math
from collections.abc import Callable, Iterator
from dataclasses import InitVar, dataclass, field
from itertools import islice
from typing import NamedTuple

import numpy as np

LINK = 0.6  # m, between two returns of one body: at 10 m two lasers are 0.35 m apart, and a biplane's wings 0.43 m
REACH = 0.8  # m, around the middle of a body within which its returns are looked for
REACH_WHOLE = 1.2  # m, likewise, within which a whole body lies
AROUND = REACH + LINK  # m, around a place, within which lies all that is looked at there
ROUGH = 0.01  # m, by which a coordinate in single precision may be off, and more
MOST_RETURNS = 300  # around a place, up to which a whole body is looked for
LARGEST = 2.5  # m, diagonal of what may be a body
MEASURED = 0.05  # m, standard deviation of the middle of a body, however many returns it has
SCATTER = 0.35  # m, of one return around it
MANOEUVRE = 1.5  # m/s², standard deviation of its acceleration
SPEEDS = (1.5, 8.0)  # m/s, of what counts as moving
UNKNOWN_SPEED = 3.0  # m/s, standard deviation of each component before a body has been seen twice
LEAST_RETURNS = 3  # that a body begins with
CONFIRMED = 3  # scans that have seen it
FRESH = 2  # of these, scans that saw it where an earlier one saw through
COASTING = 8  # scans for which a body is believed to fly on unseen, if it was seen as often; one if not confirmed
MOST_TRACKS = 12  # of one sensor, so that a bad scan costs little
LARGEST_SURPRISE = 9.0  # mean squared distance from where it was expected, over its variance; 3 is usual


@dataclass
class Track:
    """One body: where it is ``[3]``, its velocity ``[3]``, and how sure that is, the same along each axis."""

    position: np.ndarray
    size: float
    returns: InitVar[int]
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    variances: tuple[float, float, float] = (0.0, 0.0, 0.0)

    seen: int = 1
    fresh: int = 1
    missed: int = 0
    surprise: float = 1.0
    #: which returns of the last scan are its own; none where it was not seen
    body: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self, returns: int) -> None:
        """Begins with what is known of a body that was seen once."""
        self.variances = (MEASURED**2 + SCATTER**2 / returns, 0.0, UNKNOWN_SPEED**2)

    def predict(self, dt: float) -> None:
        """Flies on for ``dt`` seconds, straight."""
        place, both, speed = self.variances
        noise = MANOEUVRE**2
        self.position = self.position + dt * self.velocity
        self.variances = (
            place + 2 * dt * both + dt**2 * speed + noise * dt**4 / 4,
            both + dt * speed + noise * dt**3 / 2,
            speed + noise * dt**2,
        )

    def update(self, middle: np.ndarray, size: float, returns: int, fresh: bool) -> None:
        """Takes in where it was seen ``[3]``, how large, by how many returns, and whether it has just come there."""
        place, both, speed = self.variances
        total = place + MEASURED**2 + SCATTER**2 / returns
        off = middle - self.position
        self.position = self.position + place / total * off
        self.velocity = self.velocity + both / total * off
        self.variances = (place - place**2 / total, both - place * both / total, speed - both**2 / total)
        self.surprise += 0.3 * (float(off @ off) / total - self.surprise)
        self.seen, self.fresh, self.missed, self.size = self.seen + 1, self.fresh + fresh, 0, size

    @property
    def is_confirmed(self) -> bool:
        """Whether it was seen often enough, moves, and does so as straight as a body would."""
        speed = math.sqrt(self.velocity @ self.velocity)
        known = self.seen >= CONFIRMED and self.fresh >= FRESH
        return known and SPEEDS[0] < speed < SPEEDS[1] and self.size < LARGEST and self.surprise < LARGEST_SURPRISE

    @property
    def is_lost(self) -> bool:
        """Whether it has been unseen for too long."""
        return self.missed > (min(self.seen, COASTING) if self.is_confirmed else 1)


class LabelledReturns(NamedTuple):
    """The returns of a scan in the world ``[M, 3]``, and which of them may be of a moving body and are fresh, ``[M]``.

    What may be of a moving body was not there before; of this, what an earlier scan saw through is fresh.
    """

    points: np.ndarray
    moving: np.ndarray
    fresh: np.ndarray


def middle_and_size(points: np.ndarray) -> tuple[np.ndarray, float]:
    """The mean ``[3]`` of ``points [M, 3]``, and the diagonal of the box around them."""
    return points.mean(0), float(np.linalg.norm(np.ptp(points, 0)))


def squared_distances(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How far ``points [M, 3]`` are from a place ``[3]``, squared: ``[M]`` in m²."""
    x, y, z = (axis - at for axis, at in zip(points.T, place, strict=True))
    return x * x + y * y + z * z


def nearby(points: np.ndarray, place: np.ndarray, reach: float) -> np.ndarray:
    """The numbers of those ``points [M, 3]`` in m that are nearer than ``reach`` to a place ``[3]``; not of NaN.

    Most points of a scan are left out by one coordinate.

    Examples:
        >>> nearby(np.array([[0.0, 0, 0], [0.5, 3, 0], [np.nan] * 3, [0.5, 0.5, 0]]), np.zeros(3), 1.0).tolist()
        [0, 3]
    """
    axes = points.T
    strip = np.flatnonzero(np.abs(axes[0] - points.dtype.type(place[0])) < reach + ROUGH)
    return strip[squared_distances(axes.take(strip, axis=1).T, place) < reach**2]


def hanging_together(points: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Which of ``points [M, 3]`` are reached from ``seeds``, ``bool [M]``, over gaps of at most ``LINK``.

    Examples:
        >>> points = np.array([[0.0, 0, 0], [3, 0, 0], [0.5, 0, 0], [1, 0, 0]])
        >>> hanging_together(points, np.array([True, False, False, False])).tolist()
        [True, False, True, True]
    """
    reached, left, front = seeds.copy(), np.flatnonzero(~seeds), np.flatnonzero(seeds)
    while len(front) and len(left):
        x, y, z = (axis[left, None] - axis[front] for axis in points.T)
        near = (x * x + y * y + z * z < LINK**2).any(1)
        left, front = left[~near], left[near]
        reached[front] = True
    return reached


def clusters(points: np.ndarray) -> Iterator[np.ndarray]:
    """The numbers of those ``points [M, 3]`` that hang together.

    Examples:
        >>> [one.tolist() for one in clusters(np.array([[0.0, 0, 0], [3, 0, 0], [0.5, 0, 0], [1, 0, 0]]))]
        [[0, 2, 3], [1]]
    """
    left = np.arange(len(points))
    while len(left):
        group = hanging_together(points[left], np.arange(len(left)) == 0)
        yield left[group]
        left = left[~group]


def body_around(place: np.ndarray, points: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """The numbers of the returns of a body at about ``place``, none if fewer than two there are ``moving [M]``.

    A body in free air is all that hangs together with these, also what lies where the body itself was before. Where
    that is too much, as beside a wall, it is these alone.
    """
    squared = squared_distances(points, place)
    near = np.flatnonzero(squared < AROUND**2)
    squared = squared.take(near)
    seeds = moving.take(near) & (squared < REACH**2)
    if np.count_nonzero(seeds) < 2:
        return near[:0]
    if len(near) > MOST_RETURNS:
        return near[seeds]
    whole = hanging_together(points[near], seeds)
    return near[whole if squared[whole].max() < REACH_WHOLE**2 else seeds]


def follow(
    tracks: list[Track], scan: LabelledReturns, before: Callable[[np.ndarray], LabelledReturns], dt: float
) -> list[Track]:
    """The bodies after another scan: those that are still seen or believed in, and new ones.

    Args:
        tracks: those after the last scan, which are changed.
        scan: what is seen now.
        before: gives the last scan ``AROUND`` a place ``[3]``, of which what is now seen through is moving.
        dt: s, since then.
    """
    free = np.ones(len(scan.points), bool)
    for track in tracks:
        track.predict(dt)
        track.body = body = body_around(track.position, scan.points, scan.moving & free)
        if not len(body):
            track.missed += 1
            continue
        free[body] = False
        track.update(*middle_and_size(scan.points[body]), len(body), fresh=int(scan.fresh[body].sum()) >= LEAST_RETURNS)
    kept = [track for track in tracks if not track.is_lost]
    return kept + list(islice(_new(scan, before, free, dt), max(MOST_TRACKS - len(kept), 0)))


def _new(
    scan: LabelledReturns, before: Callable[[np.ndarray], LabelledReturns], free: np.ndarray, dt: float
) -> Iterator[Track]:
    """The bodies that begin with fresh returns, and with where they were in the last scan if that is seen."""
    fresh = np.flatnonzero(scan.fresh & free)
    if len(fresh) < LEAST_RETURNS:
        return
    for cluster in clusters(scan.points[fresh]):
        if len(cluster) < LEAST_RETURNS:
            continue
        body = body_around(scan.points[fresh[cluster]].mean(0), scan.points, scan.moving & free)
        if not len(body):
            continue
        free[body] = False
        middle, size = middle_and_size(scan.points[body])
        if size >= LARGEST:
            continue
        last = before(middle)
        earlier = body_around(middle, last.points, last.moving)
        track = Track(middle, size, len(body))
        if len(earlier) and (was := middle_and_size(last.points[earlier]))[1] < LARGEST:
            track = Track(*was, len(earlier))
            track.predict(dt)
            track.update(middle, size, len(body), fresh=True)
        track.body = body
        yield track
