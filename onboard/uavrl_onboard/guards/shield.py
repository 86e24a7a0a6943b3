"""A shield for any policy: it takes from a velocity what leads too fast towards something that a scan shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import body_to_level, first_least, is_inside, is_return, within, world_to_yaw
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.vehicle import DECELERATION, VEHICLE, Vehicle, stopping_distance

AZIMUTHS, RISES = 36, 10  # directions, of each of which the nearest point counts
CORRECTIONS = 20  # greatest number of changes of a velocity
SLACK = 1e-6  # m/s by which a velocity may exceed a bound without a change
EXCESS = 0.1  # m/s by which a velocity may exceed a bound after all changes; above, it is slowed as a whole
SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)  # of a velocity that is slowed as a whole


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
        nearest: m, the least range that the sensor reports. What comes nearer vanishes, so the margin is then at least
            what lies between it and the hull.
        vehicle: its hull, LiDAR and velocity limit; a velocity beyond that is slowed as a whole.

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
    nearest: float = 0.0
    vehicle: Vehicle = VEHICLE

    def __post_init__(self) -> None:
        """Refuses what bounds nothing."""
        above_0, at_least_0 = ("time", "sight"), ("lag", "margin", "nearest")
        for name in (*above_0, *at_least_0):
            value = getattr(self, name)
            if value < 0 or (name in above_0 and value == 0) or not math.isfinite(value):
                least = " above 0" if name in above_0 else " of 0 or more"
                raise UavrlError(f"A shield's {name} must be a finite number{least}, got {value}.")
        radius, half = self.vehicle.hull
        if (radius / self._kept) ** 2 + (half / (half + self._margin)) ** 2 > 1:
            raise UavrlError(
                f"The rim of a hull of radius {radius:g} m and height {self.vehicle.height:g} m sticks out of a shield "
                f"with a margin of {self._margin:g} m: raise margin."
            )

    @property
    def _margin(self) -> float:
        return max(self.margin, self.nearest - self.vehicle.radius if self.nearest else 0.0)

    @property
    def _kept(self) -> float:
        return self.vehicle.radius + self._margin

    @property
    def _sight(self) -> float:
        return sight_at(self.sight, self.vehicle.velocity_limit)

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
        if cloud.ndim != 2 or cloud.shape[1] != 3:
            raise UavrlError(f"A shield takes a cloud [points, 3], got {list(cloud.shape)}.")
        return self.bend(asked, cloud[is_return(cloud, within(self._sight))], tilt, velocity)

    def bend(
        self, asked: np.ndarray, returns: np.ndarray, tilt: tuple[float, float], velocity: np.ndarray
    ) -> np.ndarray:
        """Do what a call does with the ``returns [M, 3]`` within sight alone."""
        asked, velocity = np.asarray(asked, float), np.asarray(velocity, float)
        if not np.isfinite([*asked, *tilt, *velocity]).all():
            raise UavrlError(
                f"A shield needs finite numbers, got {asked} m/s asked for, roll and pitch {tuple(tilt)} rad, and a "
                f"velocity of {velocity} m/s."
            )
        towards, speeds = self._bounds(returns, tilt, velocity)
        found = keep_within(asked[None], towards, speeds[None])[0]
        return found * min(1.0, self.vehicle.velocity_limit / max(np.abs(found).max(), 1e-9))

    def bounds(
        self, cloud: np.ndarray, tilt: tuple[float, float], velocity: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors ``[M, 3]`` in the yaw-aligned frame, and how fast one may fly there: ``[M]`` in m/s."""
        return self._bounds(cloud[is_return(cloud, within(self._sight))], tilt, velocity)

    def _bounds(
        self, returns: np.ndarray, tilt: tuple[float, float], velocity: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The bounds of returns within sight."""
        x, y, z = np.ascontiguousarray(self._points(returns, tilt).T)  # coordinate by coordinate: that is faster
        kept = self._kept
        stretch = kept / (self.vehicle.hull[1] + self._margin)  # of heights makes hull and margin a ball
        high = z * stretch
        distances = np.sqrt(x * x + y * y + high * high)
        apart = np.maximum(distances, 1e-9)
        x, y, z = steepest = np.stack(
            [x / apart, y / apart, z * (stretch * stretch) / apart]
        )  # of the stretched distance
        slopes = np.maximum(np.sqrt(x * x + y * y + z * z), 1e-9)
        towards, gaps = np.ascontiguousarray((steepest / slopes).T), (distances - kept) / slopes
        gaps -= self.lag * (towards @ velocity).clip(min=0.0)
        chosen = _nearest_of_each_direction(towards, gaps)
        return towards[chosen], closing_speeds(gaps[chosen].clip(min=0.0), self.time, self.vehicle.velocity_limit)

    def _points(self, returns: np.ndarray, tilt: tuple[float, float]) -> np.ndarray:
        """The returns outside the hull, from its middle, in level axes: ``[M, 3]`` in m."""
        level = body_to_level(np.array([[*tilt, 0.0]]))[0]
        points = returns + np.array([0.0, 0.0, self.vehicle.lidar_above])
        return np.asarray(points[~is_inside(points, self.vehicle.hull)] @ level.T)


class Shields(Shield):
    """The :class:`Shield` as a guard of several vehicles: the last one, which bounds what stands."""

    def reset(self, which: np.ndarray) -> None:
        """Do nothing: a shield remembers nothing."""

    def lead(self, seen: Situation) -> None:
        """Return None: a shield changes no heading."""

    def filter(self, velocities: np.ndarray, seen: Situation) -> np.ndarray:
        """Return the velocities ``[N, 3]`` that the shield allows, in m/s: forward, left and up."""
        own = world_to_yaw(seen.velocities, seen.attitudes[:, 2])
        allowed = [
            self.bend(wanted, seen.standing(one, self._sight), tuple(seen.attitudes[one, :2].tolist()), own[one])
            for one, wanted in enumerate(velocities)
        ]
        return np.array(allowed).reshape(-1, 3)


def closing_speeds(gaps: np.ndarray, time: float, limit: float) -> np.ndarray:
    """How fast gaps ``[*B]`` in m may be closed, m/s: within ``time`` s, or so that a fast vehicle can brake.

    Args:
        gaps: 0 or more.
        time: in which a gap may be closed at the earliest, s.
        limit: of each component of the velocity, m/s; above 2 m/s the vehicle must be able to brake as it tilts.

    Examples:
        >>> closing_speeds(np.array([0.7, 7.0]), 0.7, 2.0).round(2).tolist()
        [1.0, 10.0]
        >>> closing_speeds(np.array([0.7, 7.0]), 0.7, 6.0).round(2).tolist()
        [1.0, 7.83]
    """
    if limit <= VEHICLE.velocity_limit:
        return np.asarray(gaps / time)
    fastest = DECELERATION * time  # with gap / time the vehicle brakes by speed / time
    beyond = (gaps - fastest * time).clip(min=0.0)
    return np.where(beyond > 0, np.sqrt(fastest**2 + 2 * DECELERATION * beyond), gaps / time)


def sight_at(sight: float, limit: float) -> float:
    """How far points bound the speed of a vehicle with a velocity ``limit`` in m/s, m: a fast one brakes earlier."""
    return sight if limit <= VEHICLE.velocity_limit else sight + stopping_distance(limit)


def _nearest_of_each_direction(towards: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Which of M points in directions ``[M, 3]`` has the least gap ``[M]`` in its part of the sphere, part by part."""
    azimuth = ((np.arctan2(towards[:, 1], towards[:, 0]) / np.pi + 1) * AZIMUTHS / 2).astype(int) % AZIMUTHS
    part = azimuth * RISES + ((towards[:, 2] + 1) / 2 * RISES).astype(int).clip(0, RISES - 1)
    return first_least(part, gaps, AZIMUTHS * RISES)


def keep_within(
    velocities: np.ndarray,
    towards: np.ndarray,
    speeds: np.ndarray,
    *,
    corrections: int = CORRECTIONS,
    shares: tuple[float, ...] = SHARES,
    slack: float = SLACK,
) -> np.ndarray:
    """Return velocities ``[N, 3]`` near the given ones that hardly exceed ``speeds [N, M]`` ``towards [M, 3]``.

    The bound that is exceeded most is met by the shortest change, again and again. A velocity that then still exceeds
    a bound by more than 0.1 m/s is multiplied by the largest of ``shares`` with which it does not, or by the last one.

    Args:
        velocities: ``[N, 3]`` m/s.
        towards: unit vectors ``[M, 3]``.
        speeds: of 0 or more, or infinity where there is no bound, m/s.
        corrections: the greatest number of changes of a velocity.
        shares: factors on a velocity, in falling order.
        slack: by how much a bound may be exceeded without a change, m/s.

    Examples:
        >>> keep_within(np.array([[2.0, 1.0, 0.0]]), np.eye(3), np.array([[0.5, 5.0, 5.0]])).tolist()
        [[0.5, 1.0, 0.0]]
    """
    if not len(towards):
        return velocities
    found, rows = velocities, np.arange(len(velocities))
    for _ in range(corrections):
        over = found @ towards.T - speeds
        worst = over.argmax(1)
        excess = over[rows, worst]
        excess[excess <= slack] = 0.0
        if not excess.any():
            return found
        found = found - excess[:, None] * towards[worst]
    flown = found @ towards.T
    factors = np.full(len(found), shares[-1], found.dtype)
    for share in reversed(shares[:-1]):
        factors[(share * flown - speeds).max(1) <= EXCESS] = share
    return factors[:, None] * found
