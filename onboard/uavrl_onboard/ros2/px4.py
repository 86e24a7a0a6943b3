"""PX4 as its uXRCE-DDS agent shows it to ROS 2: odometry and modes in, velocities out. docs/ros2.md says how."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from uavrl_onboard.autopilot.frames import Pose, check_setpoint, swap_attitude, swap_world
from uavrl_onboard.autopilot.vehicle_state import HEARTBEAT_TIMEOUT, Control, VehicleStatus
from uavrl_onboard.geometry import roll_pitch_yaw, rotate, yaw_to_world
from uavrl_onboard.lidar.ros_messages import PX4_CONTROL_MODE, PX4_ODOMETRY, PX4_OFFBOARD, PX4_SETPOINT
from uavrl_onboard.ros2.dds import OnNode, idl_type, topic_of
from uavrl_onboard.ros2.vehicle import Stamps

_NED, _BODY = 1, 3  # VehicleOdometry's POSE_FRAME_NED and VELOCITY_FRAME_NED, VELOCITY_FRAME_BODY_FRD
_NOT = [math.nan] * 3  # what is not set


class Px4Ros2(OnNode):
    """PX4 by its topics in ROS 2; a `uavrl_onboard.flight.interfaces.VehicleLink`.

    It arms nothing and changes no mode: the pilot does. Set-points are TrajectorySetpoint, whose velocity is in the
    world's axes; they are turned there with the newest yaw, and not sent before there is one. With each goes an
    OffboardControlMode, which is PX4's sign of life: where none is sent, PX4 leaves Offboard after COM_OF_LOSS_T.

    Args:
        source: ``ros2:///fmu``, what PX4's topics begin with, or ``ros2://DOMAIN/NAMESPACE/fmu``.

    Raises:
        UavrlError: where cyclonedds is missing, or its domain cannot be entered.
    """

    def __init__(self, source: str = "ros2:///fmu") -> None:
        domain, prefix = topic_of(source)
        self._odometry, self._mode = f"{prefix}/out/vehicle_odometry", f"{prefix}/out/vehicle_control_mode"
        self._setpoint, self._offboard = f"{prefix}/in/trajectory_setpoint", f"{prefix}/in/offboard_control_mode"
        self._stamps = Stamps(self._odometry)
        self._pose: Pose | None = None
        self._heard: Any = None
        self._heard_at = 0.0
        self._had_mode = False
        super().__init__(domain)
        self._node.reads(self._odometry, PX4_ODOMETRY)
        self._node.reads(self._mode, PX4_CONTROL_MODE)
        self._node.writes(self._setpoint, PX4_SETPOINT)
        self._node.writes(self._offboard, PX4_OFFBOARD)
        self._node.start()

    def receive(self, now: float) -> None:
        """Reads what has come."""
        if arrived := self._node.take(self._mode):
            self._heard, self._heard_at = arrived.message, arrived.now
            self._had_mode = self._had_mode or self._heard.flag_control_offboard_enabled
        if arrived := self._node.take(self._odometry):
            stamp = self._stamps.of(arrived.message.timestamp * 1e-6, arrived)
            if stamp is not None:
                self._pose = px4_pose(arrived.message, stamp)

    def pose(self) -> Pose | None:
        """Where the vehicle was last, which may not be finite; ``None`` before it has told."""
        return self._pose

    def status(self, now: float) -> VehicleStatus:
        """Who flies the vehicle."""
        if self._heard is None:
            return VehicleStatus(Control.WAITING, f"nothing has come on {self._mode} yet")
        offboard, armed = self._heard.flag_control_offboard_enabled, self._heard.flag_armed
        silent = now - self._heard_at
        if silent > HEARTBEAT_TIMEOUT:
            control, sentence = Control.LOST, f"nothing on {self._mode} for {silent:.1f} s"
        elif offboard and armed:
            control, sentence = Control.IN_CONTROL, "PX4 flies by set-points (OFFBOARD)"
        elif offboard:
            control, sentence = Control.DISARMED, "PX4 is in OFFBOARD, and not armed"
        elif self._had_mode:
            control, sentence = Control.TAKEN_OVER, "PX4 has left OFFBOARD"
        else:
            control, sentence = Control.OTHER_MODE, "PX4 is not in OFFBOARD"
        return VehicleStatus(control, sentence, "PX4", "OFFBOARD" if offboard else "another", armed)

    def send(self, setpoint: Sequence[float] | np.ndarray | None, now: float) -> None:
        """Sends a set-point (l_x, l_y, l_z, a_z), or nothing.

        Raises:
            UavrlError: for a set-point that is not four finite numbers.
        """
        if setpoint is None or self._pose is None or not math.isfinite(self._pose.yaw):
            return
        micros = time.time_ns() // 1000  # which PX4 maps to its own clock
        mode = idl_type(PX4_OFFBOARD)(micros, False, True, False, False, False, False, False)
        self._node.write(self._offboard, mode)
        self._node.write(self._setpoint, px4_setpoint(setpoint, self._pose.yaw, micros))


def px4_pose(odometry: Any, stamp: float) -> Pose:
    """The pose in a VehicleOdometry, from north, east, down to the world's axes; NaN where it is in another frame."""
    ned = odometry.pose_frame == _NED
    position = swap_world(odometry.position) if ned else (math.nan,) * 3
    velocity = odometry.velocity
    if odometry.velocity_frame == _BODY:
        velocity = rotate(velocity, odometry.q)
    elif odometry.velocity_frame != _NED:
        velocity = _NOT
    roll, pitch, yaw = swap_attitude(*roll_pitch_yaw(odometry.q)) if ned else (math.nan,) * 3
    return Pose(stamp, position, swap_world(velocity), yaw, roll, pitch, odometry.reset_counter)


def px4_setpoint(setpoint: Sequence[float] | np.ndarray, yaw: float, micros: int) -> Any:
    """A set-point as a TrajectorySetpoint: its velocity to the north, east and down, its yaw rate to the right.

    Args:
        setpoint: (l_x, l_y, l_z, a_z).
        yaw: of the vehicle, from east to the left, rad.
        micros: the time in microseconds since 1970.
    """
    *body, to_the_left = check_setpoint(setpoint)
    velocity = list(swap_world(yaw_to_world(np.array(body), yaw).tolist()))
    return idl_type(PX4_SETPOINT)(micros, _NOT, velocity, _NOT, _NOT, math.nan, 0.0 - to_the_left)
