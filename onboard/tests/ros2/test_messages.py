"""The bytes of ROS 2's messages, held against another library's."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tests.helpers.ros2_peer import same

from uavrl_onboard.lidar.ros_messages import CLOUD, DEFINITIONS, PX4_CONTROL_MODE, PX4_SETPOINT
from uavrl_onboard.ros2.dds import idl_type
from uavrl_onboard.ros2.vehicle import header_at, twist_of

pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")

# As PX4/px4_msgs has them at v1.17.0, comments and constants left out; PX4's agent hands their bytes on as they are.
PX4 = {
    "px4_msgs/msg/TrajectorySetpoint": "uint64 timestamp\nfloat32[3] position\nfloat32[3] velocity\n"
    "float32[3] acceleration\nfloat32[3] jerk\nfloat32 yaw\nfloat32 yawspeed",
    "px4_msgs/msg/OffboardControlMode": "uint64 timestamp\nbool position\nbool velocity\nbool acceleration\n"
    "bool attitude\nbool body_rate\nbool thrust_and_torque\nbool direct_actuator",
    "px4_msgs/msg/VehicleOdometry": "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\n"
    "float32[3] position\nfloat32[4] q\nuint8 velocity_frame\nfloat32[3] velocity\nfloat32[3] angular_velocity\n"
    "float32[3] position_variance\nfloat32[3] orientation_variance\nfloat32[3] velocity_variance\n"
    "uint8 reset_counter\nint8 quality",
}
# The same type in three releases: only its beginning is the same.
_BEGINS = "uint64 timestamp\nbool flag_armed\nbool flag_multicopter_position_control_enabled\n"
_BEGINS += "bool flag_control_manual_enabled\nbool flag_control_auto_enabled\nbool flag_control_offboard_enabled\n"
_MODES = {
    "v1.14": "rates attitude acceleration velocity position altitude climb_rate termination",
    "v1.17": "position velocity altitude climb_rate acceleration attitude rates allocation termination",
    "v1.18": "position velocity altitude climb_rate attitude rates allocation",
}
CONTROL_MODES = {
    name: _BEGINS + "\n".join(f"bool flag_control_{flag}_enabled" for flag in flags.split())
    for name, flags in _MODES.items()
}


def typestore(distribution: str = "ROS2_HUMBLE") -> Any:
    store = get_typestore(Stores[distribution])
    for name, text in PX4.items():
        store.register(get_types_from_msg(text, name))
    return store


def filled(store: Any, name: str, numbers: Iterator[int]) -> Any:
    """A message of `rosbags` whose fields hold one number after the other."""

    def value(node: int, form: Any) -> Any:
        if node == Nodetype.NAME:
            return filled(store, form, numbers)
        if node == Nodetype.BASE:
            number = next(numbers)
            return {"bool": bool(number % 2), "string": f"text {number}"}.get(form[0], number)
        (inner, what), count = form
        if inner == Nodetype.NAME:
            return [value(inner, what) for _ in range(3)]
        return np.array([next(numbers) for _ in range(count or 5)], what[0])

    return store.types[name](*[value(*kind) for _, kind in store.fielddefs[name][1]])


DISTRIBUTIONS = ["ROS2_HUMBLE", "ROS2_JAZZY", "ROS2_KILTED"]
OF_ROS = [name for name in DEFINITIONS if not name.startswith(("velodyne_msgs/", "px4_msgs/"))]


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_messages_have_the_bytes_that_another_library_gives_them(distribution: str) -> None:
    store = typestore(distribution)
    for name in [*OF_ROS, *PX4]:
        theirs = filled(store, name, count(1))
        data = bytes(store.serialize_cdr(theirs, name))
        ours = idl_type(name).deserialize(data)
        assert same(ours, theirs), name
        fields = [getattr(ours, field) for field in ours.__dataclass_fields__]
        assert idl_type(name)(*fields).serialize() == data, name


@pytest.mark.parametrize("release", CONTROL_MODES)
def test_px4_s_modes_are_read_whatever_its_release(release: str) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(CONTROL_MODES[release], PX4_CONTROL_MODE))
    flags = [name for name, _ in store.fielddefs[PX4_CONTROL_MODE][1]][1:]
    for true in flags[:5]:
        theirs = store.types[PX4_CONTROL_MODE](7, *[flag == true for flag in flags])
        ours = idl_type(PX4_CONTROL_MODE).deserialize(bytes(store.serialize_cdr(theirs, PX4_CONTROL_MODE)))
        assert [name for name in flags[:5] if getattr(ours, name)] == [true] and ours.timestamp == 7


def test_a_cloud_is_written_as_cyclonedds_would_write_it_byte_by_byte() -> None:
    data = bytes(range(256)) * 3
    field = idl_type("sensor_msgs/msg/PointField")("x", 0, 7, 1)
    message = idl_type(CLOUD)(header_at(1.5, "lidar"), 1, 64, [field], False, 12, len(data), data, False)
    assert message.serialize() == type(message).__idl__.serialize(message)
    assert bytes(type(message).deserialize(message.serialize()).data) == data


def test_the_bytes_of_a_twist() -> None:
    assert twist_of((1.5, 0.5, -0.25, 1.25)).serialize() == bytes([0, 1, 0, 0]) + struct.pack(
        "<6d", 1.5, 0.5, -0.25, 0.0, 0.0, 1.25
    )


def test_types_have_the_names_that_ros_2_gives_them_in_dds() -> None:
    assert idl_type(CLOUD).__idl__.idl_transformed_typename == "sensor_msgs::msg::dds_::PointCloud2_"
    assert idl_type(PX4_SETPOINT).__idl__.idl_transformed_typename == "px4_msgs::msg::dds_::TrajectorySetpoint_"
