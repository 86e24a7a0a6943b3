"""The vehicle that guards, planners, limits, observations and pictures assume."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from uavrl_onboard.errors import UavrlError

DECELERATION = 5.4  # m/s², level: g tan(0.5 rad), that of the largest tilt
REACTION = 0.3  # s, until a commanded velocity is flown
# Of the simulated quadrotor, hector_quadrotor with a Velodyne VLP-16 on top: Meyer et al. (2012).
ARM = 0.275  # m, from the centre to each rotor's axis
ROTOR_DIRECTIONS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])  # in front, left, at the back, right
LIDAR_DIAMETER, LIDAR_HEIGHT = 0.103, 0.072  # m

Hull = tuple[float, float]  # m: the radius, and half the height
Place = tuple[float, float, float]


@dataclass(frozen=True)
class Vehicle:
    """A vehicle as everything around a policy sees it: its hull, its LiDAR, its limits and its flight level.

    The simulator makes it from an airframe (:meth:`uavrl.envs.Airframe.vehicle`), and a flight makes it from
    a policy's contract (:attr:`uavrl_onboard.policy.contract.Contract.vehicle`). The defaults describe the simulated
    quadrotor: Chansuparp (2022), Table 4.1, for limits, control rate and flight level; the hull is ours.

    Args:
        radius: Radius of the hull, an upright cylinder, in m.
        height: Height of the hull in m.
        lidar_position: Position of the LiDAR in m in body axes, from the middle of the hull: forward, left, up.
        velocity_limit: Greatest forward, left and up velocity each, in m/s.
        yaw_rate_limit: Greatest yaw rate in rad/s.
        control_rate: Scans, and so actions, per second, in Hz.
        flight_level: Altitude that the vehicle returns to, in m.
        lowest: Lowest altitude at which it may fly, in m above the flight level; negative.
        highest: Highest altitude at which it may fly, in m above the flight level.
        lidar_elevations: Lowest and highest ray of the LiDAR in degrees, between which motion is looked for.
        lidar_repeats: Whether each of its scans has the same rays, for the same purpose.

    Raises:
        UavrlError: for a number that is not finite, a size, limit, rate or level that is not above 0, a LiDAR position
            that is not three numbers, and for offsets that do not enclose the flight level.

    Examples:
        >>> Vehicle().hull, Vehicle().period, Vehicle(radius=0.5).lidar_above
        ((0.35, 0.14), 0.1, 0.1)
    """

    radius: float = 0.35
    height: float = 0.28
    lidar_position: Place = (0.0, 0.0, 0.1)
    velocity_limit: float = 2.0
    yaw_rate_limit: float = 2.0
    control_rate: float = 10.0
    flight_level: float = 3.5
    lowest: float = -2.3
    highest: float = 0.7
    lidar_elevations: tuple[float, float] = (-15.0, 15.0)
    lidar_repeats: bool = True

    def __post_init__(self) -> None:
        """Refuse a vehicle that nothing can be computed with."""
        object.__setattr__(self, "lidar_position", lidar_place(self.lidar_position))
        low, high = self.lidar_elevations
        if not -90.0 <= low <= high <= 90.0:
            raise UavrlError(
                f"A vehicle's lidar_elevations must be two angles in [-90, 90] degrees, the lower one first, got "
                f"{self.lidar_elevations}."
            )
        for name in (field.name for field in fields(self) if not field.name.startswith("lidar_")):
            value, signed = getattr(self, name), name in ("lowest", "highest")
            if not (isinstance(value, int | float | np.number) and math.isfinite(value) and (signed or value > 0)):
                least = "" if signed else " above 0"
                raise UavrlError(f"A vehicle's {name} must be a finite number{least}, got {value!r}.")
        if not self.lowest < 0.0 < self.highest:
            raise UavrlError(
                f"A vehicle's lowest and highest are offsets from its flight level, the former below 0 and the latter "
                f"above 0, got {self.lowest:g} and {self.highest:g} m."
            )

    @property
    def hull(self) -> Hull:
        """Radius and half the height of the hull in m."""
        return self.radius, self.height / 2

    @property
    def lidar_above(self) -> float:
        """Height of the LiDAR above the middle of the hull in m."""
        return self.lidar_position[2]

    @property
    def period(self) -> float:
        """Time between two scans in s."""
        return 1.0 / self.control_rate


_AHEAD = 0.5  # m, seen beyond the place where a vehicle would stand


def stopping_distance(speed: float) -> float:
    """Return how far a vehicle flies on until it stands, in m, from a speed in m/s.

    Examples:
        >>> [round(stopping_distance(speed), 2) for speed in (2.0, 4.0, 6.0)]
        [0.97, 2.68, 5.13]
    """
    return speed**2 / (2 * DECELERATION) + REACTION * speed


def sight_for(max_speed: object) -> float:
    """Return how far the cells reach at a speed in m/s, in m: 4 (Table 4.1), or as far as a vehicle needs to stop.

    Examples:
        >>> [sight_for(speed) for speed in (2.0, 4.0, 5.0, 6.0)]
        [4.0, 4.0, 5.0, 6.0]
    """
    if not isinstance(max_speed, int | float) or not 0 < max_speed < 100:
        return 4.0  # env.max_speed is refused elsewhere
    needed = stopping_distance(max_speed) + VEHICLE.radius + _AHEAD
    return max(4.0, math.ceil(2 * needed) / 2)


def lidar_place(position: object) -> Place:
    """Return the position of a LiDAR in body axes as three finite numbers in m.

    Raises:
        UavrlError: for anything else.

    Examples:
        >>> lidar_place([0, 0, 0.1])
        (0.0, 0.0, 0.1)
    """
    try:
        place = np.asarray(position, float)
    except (TypeError, ValueError):
        place = np.full(0, np.nan)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise UavrlError(f"sensor_position must be three finite numbers in m: forward, left, up; got {position!r}.")
    forward, left, up = place.tolist()
    return forward, left, up


VEHICLE = Vehicle()
"""The simulated quadrotor, whose numbers are the defaults everywhere."""
