"""Another node of ROS 2, on cyclonedds alone: what a driver, an estimator or PX4's agent would publish and read."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from uavrl_onboard.lidar.ros_messages import CLOUD, HEADER, ODOMETRY, PX4_CONTROL_MODE, PX4_ODOMETRY
from uavrl_onboard.ros2.dds import idl_type

LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>9</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
    # Nodes of ROS 2 and PX4's agent send no type information, so that only the names of the types have to be the same.
    "<Compatibility><IgnoreTypeInformation>1.16</IgnoreTypeInformation></Compatibility></Domain></CycloneDDS>"
)
DOMAIN = 1 + os.getpid() % 100  # one for each process of the tests


class RosNode:
    """A participant with the qualities of service that ROS 2 and PX4's agent use."""

    def __init__(self, domain: int) -> None:
        from cyclonedds.domain import DomainParticipant

        self.participant = DomainParticipant(domain)

    def writer(self, topic: str, kind: Any, *, reliable: bool = True, transient: bool = False) -> Any:
        """Of a topic by its name in DDS; ROS's default is reliable, of sensors and PX4 it is not."""
        from cyclonedds.pub import DataWriter
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.topic import Topic

        return DataWriter(
            self.participant,
            Topic(self.participant, topic, kind),
            Qos(
                Policy.Reliability.Reliable(100_000_000) if reliable else Policy.Reliability.BestEffort,
                Policy.Durability.TransientLocal if transient else Policy.Durability.Volatile,
                Policy.History.KeepLast(5),
            ),
        )

    def reader(self, topic: str, kind: Any, *, reliable: bool = True) -> Any:
        """Of a topic by its name in DDS."""
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        return DataReader(
            self.participant,
            Topic(self.participant, topic, kind),
            Qos(
                Policy.Reliability.Reliable(100_000_000) if reliable else Policy.Reliability.BestEffort,
                Policy.Durability.Volatile,
                Policy.History.KeepLast(10),
            ),
        )


def until(found: Callable[[], Any], what: str, seconds: float = 60.0) -> Any:
    """What a function gives, once it gives something."""
    end = time.monotonic() + seconds
    while not (result := found()):
        assert time.monotonic() < end, f"{what} did not come within {seconds} s"
        time.sleep(0.005)
    return result


def header(stamp: float, frame_id: str = "velodyne") -> Any:
    """A header with a time in s since 1970."""
    return idl_type(HEADER)(idl_type("builtin_interfaces/msg/Time")(int(stamp), int(stamp % 1 * 1e9)), frame_id)


def cloud(points: np.ndarray, stamp: float, frame: str = "velodyne") -> Any:
    """A PointCloud2 as Velodyne's driver packs it: x, y, z, intensity, ring and time in 22 bytes."""
    field = idl_type("sensor_msgs/msg/PointField")
    layout = [("x", 0, 7, "<f4"), ("y", 4, 7, "<f4"), ("z", 8, 7, "<f4"), ("intensity", 12, 7, "<f4")]
    layout += [("ring", 16, 4, "<u2"), ("time", 18, 7, "<f4")]
    names, offsets, _, formats = (list(column) for column in zip(*layout, strict=True))
    packed = np.zeros(len(points), np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 22}))
    for column, axis in enumerate("xyz"):
        packed[axis] = points[:, column]
    fields = [field(name, offset, kind, 1) for name, offset, kind, _ in layout]
    data = packed.tobytes()
    return idl_type(CLOUD)(header(stamp, frame), 1, len(points), fields, False, 22, len(data), data, True)


def odometry(
    position: tuple[float, float, float],
    yaw: float,
    stamp: float,
    velocity: tuple[float, float, float] = (0, 0, 0),
    frame: str = "odom",
) -> Any:
    """An Odometry of a vehicle that is level; the velocity in its own axes."""
    point, vector, turn = (idl_type(f"geometry_msgs/msg/{name}") for name in ("Point", "Vector3", "Quaternion"))
    pose = idl_type("geometry_msgs/msg/Pose")(point(*position), turn(0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)))
    twist = idl_type("geometry_msgs/msg/Twist")(vector(*map(float, velocity)), vector(0.0, 0.0, 0.0))
    still = [0.0] * 36
    return idl_type(ODOMETRY)(
        header(stamp, frame),
        "base_link",
        idl_type("geometry_msgs/msg/PoseWithCovariance")(pose, still),
        idl_type("geometry_msgs/msg/TwistWithCovariance")(twist, still),
    )


def px4_odometry(
    ned: tuple[float, float, float],
    heading: float,
    micros: int,
    *,
    frame: int = 1,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    velocity_frame: int = 1,
) -> Any:
    """A VehicleOdometry of a vehicle that is level and heads so far from north to the right."""
    turn, none = [float(np.cos(heading / 2)), 0.0, 0.0, float(np.sin(heading / 2))], [0.0] * 3
    return idl_type(PX4_ODOMETRY)(
        micros, micros, frame, list(ned), turn, velocity_frame, list(velocity), none, none, none, none, 0, 0
    )


def px4_mode(*, armed: bool, offboard: bool) -> Any:
    """The beginning of a VehicleControlMode."""
    return idl_type(PX4_CONTROL_MODE)(0, armed, False, not offboard, False, offboard)


def same(ours: Any, theirs: Any) -> bool:
    """Whether a message of cyclonedds has the fields and the values of one of `rosbags`."""
    if isinstance(theirs, list):
        return all(same(*pair) for pair in zip(ours, theirs, strict=True))
    if isinstance(theirs, np.ndarray):
        return list(ours) == theirs.tolist()
    if hasattr(theirs, "__dataclass_fields__"):
        names = [name for name in theirs.__dataclass_fields__ if name[0].islower()]  # not constants
        return list(ours.__dataclass_fields__) == names and all(
            same(getattr(ours, name), getattr(theirs, name)) for name in names
        )
    return bool(ours == theirs)
