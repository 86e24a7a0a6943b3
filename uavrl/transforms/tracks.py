"""Bodies that move straight on, followed from scan to scan by a Kalman filter."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

LINK = 0.6  # m, between two returns of one body: at 10 m two lasers are 0.35 m apart, and a biplane's wings 0.43 m
REACH = 0.8  # m, around the middle of a body within which its returns are looked for
LARGEST = 2.5  # m, diagonal of what may be a body
MEASURED = 0.2  # m, standard deviation of the middle of a body's returns
MANOEUVRE = 1.5  # m/s², standard deviation of its acceleration
SPEEDS = (1.5, 8.0)  # m/s, of what counts as moving
UNKNOWN_SPEED = 3.0  # m/s, standard deviation of each component before a body has been seen twice
LEAST_RETURNS = 3  # that a body begins with
CONFIRMED = 3  # scans that have seen it
FRESH = 2  # of these, scans that saw it where an earlier one saw through
COASTING = 4  # scans for which a confirmed body is believed to fly on unseen; others: one
LARGEST_SURPRISE = 4.0  # mean squared distance from where it was expected, over its variance; 3 is usual


@dataclass
class Track:
    """One body: where it is ``[3]``, its velocity ``[3]``, and how sure that is, the same along each axis."""

    position: np.ndarray
    size: float
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    variances: tuple[float, float, float] = (MEASURED**2, 0.0, UNKNOWN_SPEED**2)  # of position, both, velocity
    seen: int = 1
    fresh: int = 1
    missed: int = 0
    surprise: float = 1.0

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

    def update(self, middle: np.ndarray, size: float, fresh: bool) -> None:
        """Takes in where it was seen ``[3]``, how large, and whether it has just come there."""
        place, both, speed = self.variances
        total = place + MEASURED**2
        off = middle - self.position
        self.position = self.position + place / total * off
        self.velocity = self.velocity + both / total * off
        self.variances = (place - place**2 / total, both - place * both / total, speed - both**2 / total)
        self.surprise += 0.3 * (float(off @ off) / total - self.surprise)
        self.seen, self.fresh, self.missed, self.size = self.seen + 1, self.fresh + fresh, 0, size

    @property
    def is_confirmed(self) -> bool:
        """Whether it was seen often enough, moves, and does so as straight as a body would."""
        speed = float(np.linalg.norm(self.velocity))
        known = self.seen >= CONFIRMED and self.fresh >= FRESH
        return known and SPEEDS[0] < speed < SPEEDS[1] and self.size < LARGEST and self.surprise < LARGEST_SURPRISE

    @property
    def is_lost(self) -> bool:
        """Whether it has been unseen for too long."""
        return self.missed > (COASTING if self.is_confirmed else 1)


def middle_and_size(points: np.ndarray) -> tuple[np.ndarray, float]:
    """The mean ``[3]`` of ``points [M, 3]``, and the diagonal of the box around them."""
    return points.mean(0), float(np.linalg.norm(np.ptp(points, 0)))


def clusters(points: np.ndarray) -> Iterator[np.ndarray]:
    """The numbers of those ``points [M, 3]`` that hang together over gaps of at most ``LINK``.

    Examples:
        >>> [one.tolist() for one in clusters(np.array([[0.0, 0, 0], [3, 0, 0], [0.5, 0, 0], [1, 0, 0]]))]
        [[0, 2, 3], [1]]
    """
    near = ((points[:, None] - points) ** 2).sum(-1) < LINK**2
    left = np.ones(len(points), bool)
    while left.any():
        group = np.zeros(len(points), bool)
        group[np.argmax(left)] = True
        while (wider := near[group].any(0) & left).sum() > group.sum():
            group = wider
        left &= ~group
        yield np.flatnonzero(group)


def follow(tracks: list[Track], points: np.ndarray, fresh: np.ndarray, dt: float) -> list[Track]:
    """The bodies after another scan: those that are still seen or believed in, and new ones.

    Args:
        tracks: those after the last scan, which are changed.
        points: ``[M, 3]``, the returns that may be of moving bodies.
        fresh: ``[M]``, those that lie where an earlier scan saw through.
        dt: s, since the last scan.
    """
    free = np.ones(len(points), bool)
    for track in tracks:
        track.predict(dt)
        near = _around(track.position, points, free)
        if len(near) < 2:
            track.missed += 1
            continue
        free[near] = False
        track.update(*middle_and_size(points[near]), fresh=int(fresh[near].sum()) >= LEAST_RETURNS)
    tracks = [track for track in tracks if not track.is_lost]
    fresh = np.flatnonzero(fresh & free)
    for cluster in clusters(points[fresh]) if len(fresh) >= LEAST_RETURNS else ():
        near = _around(middle_and_size(points[fresh[cluster]])[0], points, free)
        if len(cluster) >= LEAST_RETURNS and len(near):
            free[near] = False
            middle, size = middle_and_size(points[near])
            if size < LARGEST:
                tracks.append(Track(middle, size))
    return tracks


def _around(place: np.ndarray, points: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The numbers of free points within reach of a place."""
    return np.flatnonzero(free & (((points - place) ** 2).sum(-1) < REACH**2))
