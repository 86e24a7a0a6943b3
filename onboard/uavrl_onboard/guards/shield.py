"""A shield for any policy: it takes from a velocity what leads too fast towards something that a scan shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import body_to_level, inside
from uavrl_onboard.perception.cells import NEAREST_RETURN

AZIMUTHS, RISES = 36, 10  # directions, of each of which the nearest point counts
SWEEPS = 20  # most corrections of a velocity
LEFT = 0.1  # m/s by which the last of them may still be too fast


@dataclass(frozen=True)
class Shield:
    """Bends velocities so that a vehicle closes no gap too fast.

    Each point of the scan forbids the velocities that would close the gap between it and the hull within less than
    ``time``: n·v ≤ gap / time, where n points from the hull to it, and the gap is what is left after ``lag``, for which
    the vehicle goes on as it flies. What is flown is near to what was asked for, and at most 0.1 m/s over a bound.
    In free air nothing changes. Hull and margin are taken for an ellipsoid, which holds the hull, a level cylinder, but
    is nearer to its rims than the margin.

    Source: Faverjon and Tournassoud (1987), A local based approach for path planning of manipulators with a high number
    of degrees of freedom: there the bound on the speed also falls with the gap.

    Args:
        time: s, in which a gap may be closed at the earliest.
        lag: s, until a commanded velocity is flown.
        margin: m, that is kept around the hull.
        sight: m, how far points count.
        radius: m, of the hull.
        height: m, of the hull.
        sensor: m, of the LiDAR over the hull's middle.
        nearest: m, the least range that the sensor reports. What comes nearer vanishes, so the margin is then at least
            what lies between it and the hull.
        limit: m/s, the greatest component: a velocity beyond it is slowed as a whole.

    Raises:
        UavrlError: for numbers out of range, and a hull that the ellipsoid does not hold; when called, for a cloud of
            another shape and for velocities and angles that are not finite.

    Examples:
        Something stands 1 m ahead of the hull, which may then come nearer by 0.88 m in 0.7 s; to the side is free:

        >>> ahead, level, still = np.array([[1.35, 0.0, -0.1]]), (0.0, 0.0), np.zeros(3)
        >>> Shield()(np.array([2.0, 0.5, 0.0]), ahead, level, still).round(2) + 0.0
        array([1.26, 0.5 , 0.  ])
    """

    time: float = 0.7
    lag: float = 0.3
    margin: float = 0.12
    sight: float = 2.5
    radius: float = 0.35
    height: float = 0.28
    sensor: float = 0.1
    nearest: float = 0.0
    limit: float = 2.0

    def __post_init__(self) -> None:
        """Refuses what bounds nothing."""
        above_0, at_least_0 = ("time", "sight", "radius", "height", "limit"), ("lag", "margin", "nearest")
        for name in (*above_0, *at_least_0, "sensor"):
            value = getattr(self, name)
            wrong = (name in above_0 and value <= 0) or (name in at_least_0 and value < 0)
            if wrong or not math.isfinite(value):
                least = " above 0" if name in above_0 else " of 0 or more" if name in at_least_0 else ""
                raise UavrlError(f"A shield's {name} must be a finite number{least}, got {value}.")
        if (self.radius / self._kept) ** 2 + (self.height / 2 / (self.height / 2 + self._margin)) ** 2 > 1:
            raise UavrlError(
                f"The rim of a hull of radius {self.radius:g} m and height {self.height:g} m sticks out of a shield "
                f"with a margin of {self._margin:g} m: raise margin."
            )

    @property
    def _margin(self) -> float:
        return max(self.margin, self.nearest - self.radius if self.nearest else 0.0)

    @property
    def _kept(self) -> float:
        return self.radius + self._margin

    def __call__(
        self, asked: np.ndarray, cloud: np.ndarray, tilt: tuple[float, float], velocity: np.ndarray
    ) -> np.ndarray:
        """The velocity ``[3]`` to fly in place of the one that is asked for, in m/s in the yaw-aligned body frame.

        Args:
            asked: forward, left and up.
            cloud: ``[P, 3]`` in m in the sensor frame, in any order; NaN, infinity and zeros are misses.
            tilt: roll and pitch in rad.
            velocity: at which the vehicle flies now, as ``asked``.
        """
        asked, velocity = np.asarray(asked, float), np.asarray(velocity, float)
        if cloud.ndim != 2 or cloud.shape[1] != 3:
            raise UavrlError(f"A shield takes a cloud [points, 3], got {list(cloud.shape)}.")
        if not np.isfinite([*asked, *tilt, *velocity]).all():
            raise UavrlError(
                f"A shield needs finite numbers, got {asked} m/s asked for, roll and pitch {tuple(tilt)} rad, and a "
                f"velocity of {velocity} m/s."
            )
        found = fitted(asked, *self.bounds(cloud, tilt, velocity))
        return found * min(1.0, self.limit / max(np.abs(found).max(), 1e-9))

    def bounds(
        self, cloud: np.ndarray, tilt: tuple[float, float], velocity: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors ``[M, 3]`` in the yaw-aligned frame, and how fast one may fly there: ``[M]`` in m/s."""
        points = self._points(cloud, tilt)
        kept = self._kept
        stretch = np.array([1.0, 1.0, kept / (self.height / 2 + self._margin)])  # makes hull and margin a ball
        distances = np.linalg.norm(points * stretch, axis=1)
        steepest = points * stretch**2 / np.maximum(distances, 1e-9)[:, None]  # of the stretched distance
        slopes = np.maximum(np.linalg.norm(steepest, axis=1), 1e-9)
        towards, gaps = steepest / slopes[:, None], (distances - kept) / slopes
        gaps -= self.lag * (towards @ velocity).clip(min=0.0)
        chosen = _nearest_of_each_direction(towards, gaps)
        return towards[chosen], gaps[chosen].clip(min=0.0) / self.time

    def _points(self, cloud: np.ndarray, tilt: tuple[float, float]) -> np.ndarray:
        """The returns within sight and outside the hull, from its middle, in level axes: ``[M, 3]`` in m."""
        x, y, z = cloud.T
        with np.errstate(over="ignore", invalid="ignore"):
            squared = x * x + y * y + z * z
            near = np.flatnonzero((squared > NEAREST_RETURN**2) & (squared < self.sight**2))
        level = body_to_level(np.array([[*tilt, 0.0]]))[0]
        points = np.asarray(cloud[near], float) + np.array([0.0, 0.0, self.sensor])
        return np.asarray(points[~inside(points, (self.radius, self.height / 2))] @ level.T)


def _nearest_of_each_direction(towards: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Which of M points in directions ``[M, 3]`` has the least gap ``[M]`` in its part of the sphere."""
    azimuth = ((np.arctan2(towards[:, 1], towards[:, 0]) / np.pi + 1) * AZIMUTHS / 2).astype(int) % AZIMUTHS
    part = azimuth * RISES + ((towards[:, 2] + 1) / 2 * RISES).astype(int).clip(0, RISES - 1)
    order = np.lexsort((gaps, part))
    return order[np.flatnonzero(np.diff(part[order], prepend=-1))]


def fitted(velocity: np.ndarray, towards: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """A velocity ``[3]`` near ``velocity`` that is nowhere faster ``towards [M, 3]`` than ``speed [M]``.

    The bound that is most exceeded is met by the shortest change, again and again; what still exceeds one is slowed.

    Examples:
        >>> fitted(np.array([2.0, 1.0, 0.0]), np.eye(3), np.array([0.5, 5.0, 5.0])).tolist()
        [0.5, 1.0, 0.0]
    """
    if not len(speed):
        return velocity
    fitting = velocity.copy()
    for _ in range(SWEEPS):
        over = towards @ fitting - speed
        worst = over.argmax()
        if over[worst] <= 1e-6:
            return fitting
        fitting -= over[worst] * towards[worst]
    shares = (1.0, 0.75, 0.5, 0.25, 0.0)
    return next(share * fitting for share in shares if (share * (towards @ fitting) - speed).max() <= LEFT)
