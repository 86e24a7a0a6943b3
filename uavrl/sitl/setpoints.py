"""What SET_POSITION_TARGET_LOCAL_NED asks of a vehicle, as PX4 and ArduPilot read it: the other side of a link."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from uavrl.errors import UavrlError
from uavrl_onboard.autopilot.frames import swap_world, swap_yaw, to_command
from uavrl_onboard.geometry import world_to_yaw, yaw_to_world
from uavrl_onboard.vehicle import VEHICLE

LOCAL_NED, BODY_NED = 1, 8  # MAV_FRAME
POSITION_GAIN = np.array([0.95, 0.95, 1.0])  # 1/s, PX4's defaults (MPC_XY_P, MPC_Z_P)
YAW_GAIN = 2.8  # 1/s, PX4's default (MC_YAW_P)
_YAW, _YAW_RATE = 1 << 10, 1 << 11  # of the type mask: what is ignored
_FRAMES = {LOCAL_NED: "MAV_FRAME_LOCAL_NED", BODY_NED: "MAV_FRAME_BODY_NED"}


@dataclass(frozen=True)
class Setpoint:
    """Position, velocity and yaw in the world's axes (x east, y north, z up); NaN where one is left open."""

    position: np.ndarray  #: ``[3]`` in m
    velocity: np.ndarray  #: ``[3]`` in m/s
    yaw: float  #: rad, from east to the left
    yaw_rate: float  #: rad/s, to the left
    body: np.ndarray | None = None  #: ``[4]``, the velocity in the vehicle's axes and the yaw rate, where it came so

    def demand(
        self, position: np.ndarray, yaw: float, fastest: float = VEHICLE.velocity_limit
    ) -> tuple[np.ndarray, float]:
        """The velocity ``[3]`` in the world's axes and the yaw rate that a vehicle is to fly that is there.

        Each component of the velocity is cut at ``fastest`` m/s.

        Examples:
            >>> there = Setpoint(np.array([3.0, 0.0, np.nan]), np.full(3, np.nan), math.pi / 2, np.nan)
            >>> velocity, yaw_rate = there.demand(np.array([2.0, 0.0, 5.0]), yaw=0.0)
            >>> velocity.tolist(), yaw_rate
            ([0.95, 0.0, 0.0], 2.0)
        """
        way = np.where(np.isnan(self.position), 0.0, POSITION_GAIN * (self.position - position))
        velocity = way + np.nan_to_num(self.velocity)
        turn = 0.0
        if not math.isnan(self.yaw_rate):
            turn = self.yaw_rate
        elif not math.isnan(self.yaw):
            turn = YAW_GAIN * math.remainder(self.yaw - yaw, math.tau)
        fastest_turn = VEHICLE.yaw_rate_limit
        return np.clip(velocity, -fastest, fastest), min(max(turn, -fastest_turn), fastest_turn)

    def command(self, position: np.ndarray, yaw: float, fastest: float = VEHICLE.velocity_limit) -> np.ndarray:
        """The same as an action of the simulator ``[4]``, which turns with the vehicle."""
        if self.body is not None:
            return self.body
        velocity, turn = self.demand(position, yaw, fastest)
        return np.append(world_to_yaw(velocity, yaw), turn)


def read_setpoint(message: Any, yaw: float) -> Setpoint:
    """Reads a message that arrives where the vehicle has a yaw in rad, by which PX4 turns velocities in its axes.

    Raises:
        UavrlError: for what is not obeyed: another frame, infinite numbers, nothing of position and velocity.
    """
    if message.coordinate_frame not in _FRAMES:
        known = " and ".join(_FRAMES.values())
        raise UavrlError(f"Set-points are obeyed in {known}, got frame {message.coordinate_frame}")
    numbers = np.array([message.x, message.y, message.z, message.vx, message.vy, message.vz], dtype=np.float64)
    ignored = np.array([message.type_mask >> bit & 1 for bit in range(6)], dtype=bool)
    numbers[ignored] = np.nan
    yaw_to = math.nan if message.type_mask & _YAW else float(message.yaw)
    yaw_rate = math.nan if message.type_mask & _YAW_RATE else float(message.yaw_rate)
    in_body = message.coordinate_frame == BODY_NED
    if in_body:
        numbers[:3] = np.nan
        numbers[3:] = np.nan if ignored[3:].any() else numbers[3:]
    if np.isinf([*numbers, yaw_to, yaw_rate]).any() or np.isnan(numbers).all():
        raise UavrlError(
            "A set-point has finite numbers, and a position or a velocity that its type_mask does not ignore"
        )
    position, velocity = (np.array(swap_world(part.tolist())) for part in (numbers[:3], numbers[3:]))
    turn, body = (math.nan if math.isnan(yaw_rate) else 0.0 - yaw_rate), None
    if in_body:
        body = np.array(to_command((*numbers[3:], 0.0 if math.isnan(yaw_rate) else yaw_rate)), dtype=np.float64)
        velocity = yaw_to_world(body[:3], yaw)
        body = None if math.isnan(yaw_rate) and not math.isnan(yaw_to) else body
    return Setpoint(position, velocity, swap_yaw(yaw_to), turn, body)
