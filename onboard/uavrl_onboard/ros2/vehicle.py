"""Scans and a vehicle by ROS 2, without ROS: PointCloud2 and Odometry in, Twist out. docs/ros2.md says how."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from uavrl_onboard.autopilot.clock_sync import SenderClock
from uavrl_onboard.autopilot.frames import Pose, check_setpoint
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import roll_pitch_yaw, rotate
from uavrl_onboard.lidar.bags import cloud_scan, seconds
from uavrl_onboard.lidar.frame_ids import CloudFrame
from uavrl_onboard.lidar.ros_messages import CLOUD, HEADER, ODOMETRY, TWIST, TWIST_STAMPED
from uavrl_onboard.lidar.scans import Scan, Skipped
from uavrl_onboard.ros2.dds import SILENCE, Arrived, OnNode, check_topic, idl_type, topic_of

LOST = 1.0  # s without odometry after which the vehicle is lost; it comes 20 times a second or more
_CLOCKS_AGREE = 10.0  # s: what is said to be older was stamped by another clock
KINDS = {"twist": TWIST, "twist_stamped": TWIST_STAMPED}


class Stamps:
    """When the messages of a topic were made, on our clock.

    A message's header says when. Where that is less than 10 s ago its clock agrees with ours, and its age is believed.
    Otherwise (a simulation's clock, a sensor's own) it counts from its arrival, less what it waited on its way. A
    header without a time has that at which the message was sent. One no newer than the one before is none.

    Two clocks that agree cease to when one of them is set. So the age is the lesser of two: by the clocks as they are,
    and by the clocks as they were at the first message.

    Args:
        topic: for the log.
    """

    def __init__(self, topic: str) -> None:
        self._clock = SenderClock(topic)
        self._ours: float | None = None  # our time of day at the zero of ``time.monotonic``, at the first message

    def of(self, made: float, arrived: Arrived) -> float | None:
        """The time of a message on the clock of ``time.monotonic``, s.

        Args:
            made: when its header says it was made, in s of its clock; 0 for a header that says nothing.
            arrived: the message.
        """
        made = made or arrived.sent
        self._ours = arrived.wall - arrived.now if self._ours is None else self._ours
        stamp = self._clock.stamp(made, arrived.now)
        if stamp is None:
            return None
        ages = (arrived.wall - made, arrived.now + self._ours - (made - self._clock.offset))
        age = min((each for each in ages if 0.0 <= each < _CLOCKS_AGREE), default=0.0)
        return min(stamp, arrived.now - age)


class Ros2Scans(OnNode):
    """Clouds of points as a node of ROS 2 publishes them; a `uavrl_onboard.flight.interfaces.ScanFeed`.

    Args:
        source: ``ros2:///TOPIC``, a topic of ``sensor_msgs/msg/PointCloud2``, or ``ros2://DOMAIN/TOPIC``.
        vehicle: on which the sensor is. Clouds in the frame of its positions are refused: they do not move with it.

    Attributes:
        skipped: how much was left out so far, by reason.

    Raises:
        UavrlError: where cyclonedds is missing, or its domain cannot be entered.
    """

    def __init__(self, source: str = "ros2:///velodyne_points", vehicle: Ros2Vehicle | None = None) -> None:
        domain, self.topic = topic_of(source)
        self.skipped = Skipped()
        self._vehicle, self._frame, self._refusal = vehicle, CloudFrame(), ""
        self._stamps, self._heard = Stamps(self.topic), -math.inf  # when the last cloud came
        super().__init__(domain)
        self._node.reads(self.topic, CLOUD)
        self._node.start()

    def poll(self, now: float) -> Scan | None:
        """The newest scan that has come since the last call."""
        arrived = self._node.take(self.topic)
        if arrived is None:
            return None
        self._heard = time.monotonic()
        world = "" if self._vehicle is None else self._vehicle.world_frame
        self._refusal = self._frame.refusal(arrived.message.header.frame_id, world)
        if self._refusal:
            self.skipped.other_frame += 1
            return None
        stamp = self._stamps.of(seconds(arrived.message.header.stamp), arrived)
        if stamp is None:
            self.skipped.late_messages += 1
            return None
        return cloud_scan(arrived.message, stamp, self.skipped)

    def remarks(self) -> list[str]:
        """What the user should know of the topic, though scans come."""
        return []

    def trouble(self) -> str:
        """Why no scan came out, as a sentence's second half."""
        if SILENCE < (silent := time.monotonic() - self._heard) < math.inf:
            return f"no message has come on {self.topic} for {silent:.0f} s, where there were some: look at its driver."
        if self._refusal:
            return f"the clouds on {self.topic} cannot be used: {self._refusal}."
        if self.skipped.sentences():
            return f"no cloud on {self.topic} could be taken ({'; '.join(self.skipped.sentences())})."
        return f"no message has come on {self.topic}: does a node in this domain publish {CLOUD} there, over DDS?"


class Ros2Vehicle(OnNode):
    """A vehicle flown by ROS 2 nodes, as a :class:`~uavrl_onboard.flight.interfaces.VehicleLink`.

    A Twist has no mode and no arming: whoever subscribes to it obeys it, or not. So set-points count as obeyed once
    odometry comes and somebody subscribes. An Odometry in another frame than the first one is no pose.

    Args:
        source: ``ros2:///TOPIC``, a topic of ``nav_msgs/msg/Odometry``, or ``ros2://DOMAIN/TOPIC``.
        setpoints: the topic to send to.
        kind: ``"twist"`` or ``"twist_stamped"``, of ``geometry_msgs``.
        frame_id: of a stamped one, that of the vehicle's body.

    Attributes:
        world_frame: the frame of its positions; "" before it has told.

    Raises:
        UavrlError: where cyclonedds is missing, or its domain cannot be entered.
    """

    def __init__(
        self,
        source: str = "ros2:///odom",
        *,
        setpoints: str = "/cmd_vel",
        kind: str = "twist",
        frame_id: str = "base_link",
    ) -> None:
        domain, self.topic = topic_of(source)
        if kind not in KINDS:
            raise UavrlError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}.")
        self.setpoints, self.kind, self.frame_id = check_topic(setpoints), kind, frame_id
        self._stamps = Stamps(self.topic)
        self.world_frame = ""
        self._refusal = ""
        self._pose: Pose | None = None
        self._heard_at: float | None = None
        super().__init__(domain)
        self._node.reads(self.topic, ODOMETRY)
        self._node.writes(self.setpoints, KINDS[kind])
        self._node.start()

    def receive(self, now: float) -> None:
        """Reads what has come."""
        arrived = self._node.take(self.topic)
        if arrived is None:
            return
        frame = arrived.message.header.frame_id
        self.world_frame = self.world_frame or frame
        if frame != self.world_frame:
            self._refusal = f", because its frame changed from {self.world_frame} to {frame or 'none'}"
            return
        self._heard_at, self._refusal = arrived.now, ""
        stamp = self._stamps.of(seconds(arrived.message.header.stamp), arrived)
        if stamp is not None:
            self._pose = pose_of(arrived.message, stamp)

    def pose(self) -> Pose | None:
        """Where the vehicle was last, which may not be finite; ``None`` before it has told."""
        return self._pose

    def status(self, now: float) -> VehicleStatus:
        """Who flies the vehicle, as far as a topic can tell."""
        listeners = self._node.listeners(self.setpoints)
        if self._heard_at is None:
            return VehicleStatus(Control.WAITING, f"no odometry has come on {self.topic} yet")
        if now - self._heard_at > LOST:
            silent = now - self._heard_at
            return VehicleStatus(Control.LOST, f"no odometry on {self.topic} for {silent:.1f} s{self._refusal}")
        if not listeners:
            return VehicleStatus(Control.WAITING, f"nobody subscribes to {self.setpoints}")
        sentence = f"{self.setpoints} has {listeners} subscriber{'s' * (listeners > 1)}, which may obey it"
        return VehicleStatus(Control.IN_CONTROL, sentence, "ROS 2")

    def send(self, setpoint: Sequence[float] | np.ndarray | None, now: float) -> None:
        """Sends a set-point (l_x, l_y, l_z, a_z), or nothing.

        Raises:
            UavrlError: for a set-point that is not four finite numbers.
        """
        if setpoint is not None:
            twist = twist_of(setpoint)
            if self.kind == "twist_stamped":
                twist = idl_type(TWIST_STAMPED)(header_at(time.time(), self.frame_id), twist)
            self._node.write(self.setpoints, twist)


def pose_of(odometry: Any, stamp: float) -> Pose:
    """The pose in an Odometry. Its axes are ours (REP 103): x forward, y left, z up, the velocity in the body's."""
    at, velocity = odometry.pose.pose.position, odometry.twist.twist.linear
    turn = odometry.pose.pose.orientation
    rotation = (turn.w, turn.x, turn.y, turn.z)
    moved = rotate((velocity.x, velocity.y, velocity.z), rotation)
    roll, pitch, yaw = roll_pitch_yaw(rotation)
    return Pose(stamp, (at.x, at.y, at.z), moved, yaw, roll, pitch)


def twist_of(setpoint: Sequence[float] | np.ndarray) -> Any:
    """A set-point as a Twist in the body's axes, which are ours."""
    forward, left, up, to_the_left = check_setpoint(setpoint)
    vector = idl_type("geometry_msgs/msg/Vector3")
    return idl_type(TWIST)(vector(forward, left, up), vector(0.0, 0.0, to_the_left))


def header_at(stamp: float, frame_id: str) -> Any:
    """A header with a time in s since 1970."""
    whole = int(stamp)
    return idl_type(HEADER)(idl_type("builtin_interfaces/msg/Time")(whole, int((stamp - whole) * 1e9)), frame_id)
