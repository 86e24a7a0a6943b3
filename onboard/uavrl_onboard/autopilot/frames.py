"""From the frames of an autopilot to ours and back; docs/autopilot.md has the table.

The world's axes are x east, y north, z up, from the autopilot's local origin. A vehicle's are x forward, y left, z up;
those of commands turn with its yaw alone. MAVLink's are north, east, down and forward, right, down. A rotation from a
vehicle's axes to the world's is (w, x, y, z); by its angles it is Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import Quaternion, quaternion
from uavrl_onboard.perception.goal import goal_distance, goal_elevation_deg, goal_heading_deg

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Pose:
    """Where a vehicle is, in the world's axes."""

    stamp: float  #: when the older of position and attitude arrived, s
    position: Vector  #: m
    velocity: Vector  #: m/s
    yaw: float  #: from east to the left (counter-clockwise seen from above), rad in [-π, π]
    roll: float = 0.0  #: about forward, positive with the left side up, rad
    pitch: float = 0.0  #: about left, positive with the nose down, rad
    resets: int = 0  #: how often its estimator has reset it, where that says so

    @property
    def attitude(self) -> Vector:
        """Roll, pitch and yaw, rad."""
        return self.roll, self.pitch, self.yaw

    @property
    def rotation(self) -> Quaternion:
        """From its axes to the world's; level where roll or pitch is not finite, NaN where the yaw is not."""
        tilted = math.isfinite(self.roll) and math.isfinite(self.pitch)
        roll, pitch = (self.roll, self.pitch) if tilted else (0.0, 0.0)
        return quaternion(roll, pitch, self.yaw if math.isfinite(self.yaw) else math.nan)


class Command(NamedTuple):
    """The fields of SET_POSITION_TARGET_LOCAL_NED that a set-point fills, forward, right, down."""

    vx: float
    vy: float
    vz: float
    yaw_rate: float  #: to the right


def swap_world(vector: Sequence[float]) -> Vector:
    """North, east, down to east, north, up, or back.

    Examples:
        >>> swap_world((1.0, 2.0, -3.5))
        (2.0, 1.0, 3.5)
    """
    first, second, third = vector
    return second, first, 0.0 - third


def swap_yaw(yaw: float) -> float:
    """A yaw from north to the right as one from east to the left, or back, in [-π, π].

    Examples:
        >>> swap_yaw(0.0) == math.pi / 2, swap_yaw(math.pi / 2)
        (True, 0.0)
    """
    return math.remainder(math.pi / 2 - yaw, math.tau) if math.isfinite(yaw) else math.nan


def swap_attitude(roll: float, pitch: float, yaw: float) -> Vector:
    """MAVLink's roll, pitch (nose up) and yaw as ours, or back.

    Examples:
        >>> swap_attitude(0.25, 0.5, math.pi / 2)
        (0.25, -0.5, 0.0)
    """
    return roll, 0.0 - pitch, swap_yaw(yaw)


def to_command(setpoint: Sequence[float] | np.ndarray) -> Command:
    """What MAVLink calls a set-point (l_x, l_y, l_z, a_z).

    Raises:
        UavrlError: for anything but four numbers that are finite in float32.

    Examples:
        >>> to_command((1.0, 0.5, -0.25, 2.0))
        Command(vx=1.0, vy=-0.5, vz=0.25, yaw_rate=-2.0)
    """
    forward, left, up, to_the_left = check_setpoint(setpoint)
    return Command(forward, 0.0 - left, 0.0 - up, 0.0 - to_the_left)


def check_setpoint(setpoint: Sequence[float] | np.ndarray) -> tuple[float, float, float, float]:
    """A set-point's numbers, if they are four that are finite in float32."""
    with np.errstate(over="ignore", invalid="ignore"):
        numbers = np.asarray(setpoint, dtype=np.float32)
    if numbers.shape != (4,) or not np.isfinite(numbers).all():
        raise UavrlError(f"A set-point is four finite numbers (l_x, l_y, l_z, a_z), got {setpoint!r}: it was not sent.")
    forward, left, up, to_the_left = numbers.tolist()
    return forward, left, up, to_the_left


def to_goal(pose: Pose, goal: Sequence[float]) -> dict[str, float]:
    """What a policy reads of its pose and its goal, under the names that the simulator has for them.

    Args:
        pose: of the vehicle.
        goal: x, y, z in the world's axes, m; z is the middle of the goal's height.

    Examples:
        >>> to_goal(Pose(0.0, (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), yaw=0.0), (0.0, 4.0, 6.0))
        {'altitude': 3.0, 'heading_deg': 90.0, 'elevation_deg': 36.869..., 'distance': 5.0}
    """
    position, there = np.array([pose.position]), np.array([goal], dtype=np.float64)
    heading = goal_heading_deg(position, np.array([pose.yaw]), there)
    elevation, distance = goal_elevation_deg(position, there), goal_distance(position, there)
    return {
        "altitude": pose.position[2],
        "heading_deg": float(heading[0]),
        "elevation_deg": float(elevation[0]),
        "distance": float(distance[0]),
    }
