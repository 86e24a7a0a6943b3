"""ROS 2 without ROS: bytes on the wire, frames and signs, ages, states. Nodes meet within this process."""

from __future__ import annotations

import math
import struct
import sys
import threading
import time
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uavrl.deploy.dds import Arrived, Node, check_topic, idl_type, topic_of
from uavrl.deploy.frames import Pose
from uavrl.deploy.messages import (
    CLOUD,
    DEFINITIONS,
    ODOMETRY,
    PX4_CONTROL_MODE,
    PX4_ODOMETRY,
    PX4_OFFBOARD,
    PX4_SETPOINT,
    TWIST,
)
from uavrl.deploy.ros2 import Ros2Scans, Ros2Vehicle, Stamps, pose_of, twist_of
from uavrl.deploy.ros2_px4 import Px4Ros2, px4_pose, px4_setpoint
from uavrl.deploy.vehicle import Control
from uavrl.errors import UavrlError

pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")

from tests.helpers.ros2_peer import (
    DOMAIN,
    LOOPBACK,
    RosNode,
    cloud,
    odometry,
    px4_mode,
    px4_odometry,
    until,
)

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


def test_the_bytes_of_a_twist() -> None:
    assert twist_of((1.5, 0.5, -0.25, 1.25)).serialize() == bytes([0, 1, 0, 0]) + struct.pack(
        "<6d", 1.5, 0.5, -0.25, 0.0, 0.0, 1.25
    )


def test_types_have_the_names_that_ros_2_gives_them_in_dds() -> None:
    assert idl_type(CLOUD).__idl__.idl_transformed_typename == "sensor_msgs::msg::dds_::PointCloud2_"
    assert idl_type(PX4_SETPOINT).__idl__.idl_transformed_typename == "px4_msgs::msg::dds_::TrajectorySetpoint_"


def test_a_setpoint_has_the_axes_and_signs_of_rep_103() -> None:
    twist = twist_of((1.0, 2.0, 3.0, 4.0))
    assert (twist.linear.x, twist.linear.y, twist.linear.z) == (1.0, 2.0, 3.0)
    assert (twist.angular.x, twist.angular.y, twist.angular.z) == (0.0, 0.0, 4.0)
    for wrong in ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0, math.nan)):
        with pytest.raises(UavrlError, match="four finite numbers"):
            twist_of(wrong)


def test_an_odometry_is_a_pose_whose_velocity_is_in_the_world_s_axes() -> None:
    pose = pose_of(odometry((1.0, 2.0, 3.5), math.pi / 2, 0.0, velocity=(2.0, 1.0, 0.5)), 7.0)
    assert (pose.stamp, pose.position) == (7.0, (1.0, 2.0, 3.5)) and pose.yaw == pytest.approx(math.pi / 2)
    assert pose.velocity == pytest.approx((-1.0, 2.0, 0.5))  # forward is north, left is west


def test_an_odometry_without_an_orientation_has_no_yaw() -> None:
    message = odometry((1.0, 2.0, 3.5), 0.0, 0.0)
    message.pose.pose.orientation.w = 0.0
    assert math.isnan(pose_of(message, 0.0).yaw)


@pytest.mark.parametrize(
    ("yaw", "setpoint", "ned"),
    [
        (0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),  # heads east
        (math.pi / 2, (1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),  # heads north
        (math.pi / 2, (0.0, 1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),  # north's left is west
        (math.pi, (1.0, 0.5, 0.25, 0.0), (-0.5, -1.0, -0.25)),  # heads west, its left is south
    ],
)
def test_px4_s_velocities_are_to_the_north_east_and_down(
    yaw: float, setpoint: tuple[float, ...], ned: tuple[float, ...]
) -> None:
    message = px4_setpoint([*setpoint[:3], 1.25], yaw, 99)
    assert message.velocity == pytest.approx(ned, abs=1e-12)
    assert message.timestamp == 99 and message.yawspeed == -1.25 and math.isnan(message.yaw)
    assert all(math.isnan(each) for each in [*message.position, *message.acceleration, *message.jerk])


def test_px4_s_odometry_is_turned_to_east_north_up() -> None:
    heading = math.radians(30.0)  # from north to the right
    forward = px4_pose(px4_odometry((1.0, 2.0, -3.5), heading, 0, velocity=(1.0, 0.5, 0.25), velocity_frame=3), 5.0)
    assert forward.position == (2.0, 1.0, 3.5) and forward.yaw == pytest.approx(math.radians(60.0))
    east = math.sin(heading) + 0.5 * math.cos(heading)
    assert forward.velocity == pytest.approx((east, math.cos(heading) - 0.5 * math.sin(heading), -0.25))
    north = px4_pose(px4_odometry((1.0, 2.0, -3.5), heading, 0, velocity=(1.0, 0.5, 0.25)), 5.0)
    assert north.velocity == (0.5, 1.0, -0.25)


def test_px4_s_odometry_in_another_frame_is_no_pose() -> None:
    pose = px4_pose(px4_odometry((1.0, 2.0, -3.5), 0.0, 0, frame=2, velocity_frame=2), 5.0)
    assert np.isnan([*pose.position, *pose.velocity, pose.yaw]).all()


def arrived(wall: float, now: float, sent: float | None = None) -> Arrived:
    return Arrived(None, wall if sent is None else sent, wall, now)


@pytest.mark.parametrize(
    ("made", "stamp"),
    [
        (999.97, 49.97),  # 30 ms ago by a clock that agrees with ours
        (1000.2, 50.0),  # a clock that runs ahead
        (12.0, 50.0),  # a simulation's
        (980.0, 50.0),  # 20 s ago: another clock, or a recording
        (0.0, 49.99),  # none: when it was sent
    ],
)
def test_the_age_of_a_message_is_believed_where_the_clocks_agree(made: float, stamp: float) -> None:
    assert Stamps().of(made, arrived(1000.0, 50.0, sent=999.99)) == pytest.approx(stamp)


def test_a_message_that_waited_is_old_whatever_its_clock() -> None:
    stamps = Stamps()
    times = [(12.0, 50.0), (12.1, 50.1), (12.2, 50.7), (12.2, 50.8), (12.15, 50.9), (13.0, 51.0)]
    given = [stamps.of(made, arrived(1000.0 + now, now)) for made, now in times]
    assert given == [pytest.approx(each) if each else None for each in (50.0, 50.1, 50.21, None, None, 51.0)]


def test_an_address_names_a_domain_and_a_topic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert topic_of("ros2:///lidar/points") == (0, "/lidar/points") and topic_of("ros2://42/odom") == (42, "/odom")
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert topic_of("ros2:///odom") == (7, "/odom") and topic_of("ros2://0/odom") == (0, "/odom")
    for wrong in ("ros2:/odom", "ros2://", "ros2:///", "ros2:///a//b", "ros2:///1a", "udp://:2368"):
        with pytest.raises(UavrlError, match=r"ros2:///TOPIC or ros2://DOMAIN/TOPIC, such as ros2:///odom, got"):
            topic_of(wrong)
    with pytest.raises(UavrlError, match="from 0 to 232, got '233'"):
        topic_of("ros2://233/odom")
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(UavrlError, match="from 0 to 232, got 'many'"):
        topic_of("ros2:///odom")
    with pytest.raises(UavrlError, match="letters, digits and underscores, got 'cmd_vel'"):
        check_topic("cmd_vel")


def test_without_cyclonedds_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cyclonedds.core", None)
    with pytest.raises(UavrlError, match=r"pip install 'uavrl\[ros2\]'"):
        Ros2Scans()


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> RosNode:
    """Another node, on this machine alone."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    return RosNode(DOMAIN)


def test_clouds_come_as_scans(node: RosNode) -> None:
    points = np.array([[1.0, 2.0, 3.0], [np.nan] * 3, [0.0, 0.0, 0.0], [-4.0, 5.5, 6.0]], np.float32)
    writer = node.writer("rt/lidar/points", idl_type(CLOUD), reliable=False)
    with Ros2Scans(f"ros2://{DOMAIN}/lidar/points") as scans:
        until(lambda: writer.get_matched_subscriptions(), "a match")
        assert scans.poll(0.0) is None
        made = time.time() - 0.05
        writer.write(cloud(points, made))
        scan = until(lambda: scans.poll(0.0), "a scan")
        np.testing.assert_array_equal(scan.points, points)
        assert (scan.rays, scan.misses) == (4, 2)
        assert time.monotonic() - scan.stamp == pytest.approx(time.time() - made, abs=0.02)
        writer.write(cloud(points, made))  # sent again: it is no new scan
        until(lambda: scans.poll(0.0) or scans.skipped.late, "the repetition")
        broken = cloud(points, made + 0.1)
        broken.data = broken.data[:40]
        writer.write(broken)
        until(lambda: scans.poll(0.0) or scans.skipped.malformed, "the broken cloud")
        assert scans.skipped.sentences() == ["1 packets out of order", "1 messages that could not be read"]


def test_what_is_no_text_does_no_harm(node: RosNode) -> None:
    writer = node.writer("rt/points", idl_type(CLOUD))
    with Ros2Scans(f"ros2://{DOMAIN}/points") as scans:
        until(lambda: writer.get_matched_subscriptions(), "a match")
        bad = cloud(np.ones((2, 3), np.float32), 1.0)
        bad.header.frame_id = type("NoText", (str,), {"encode": lambda self, *_: b"\xff"})("x")
        writer.write(bad)
        time.sleep(0.05)
        writer.write(cloud(np.ones((2, 3), np.float32), 2.0))
        assert until(lambda: scans.poll(0.0), "the next cloud").rays == 2


@pytest.mark.parametrize("kind", ["twist", "twist_stamped"])
def test_a_vehicle_is_told_velocities_while_its_odometry_comes(node: RosNode, kind: str) -> None:
    name = {"twist": TWIST, "twist_stamped": "geometry_msgs/msg/TwistStamped"}[kind]
    writer = node.writer("rt/odom", idl_type(ODOMETRY))
    with Ros2Vehicle(f"ros2://{DOMAIN}/odom", setpoints="/cmd", kind=kind) as vehicle:
        until(lambda: writer.get_matched_subscriptions(), "a match")
        assert vehicle.status(0.0).sentence == "no odometry has come on /odom yet" and vehicle.pose() is None
        writer.write(odometry((1.0, 2.0, 3.5), 0.5, time.time()))

        def posed() -> Pose | None:
            vehicle.receive(time.monotonic())
            return vehicle.pose()

        pose = until(posed, "a pose")
        assert pose.position == (1.0, 2.0, 3.5) and pose.yaw == pytest.approx(0.5)
        now = time.monotonic()
        assert now - pose.stamp < 0.1
        status = vehicle.status(now)
        assert (status.control, status.sentence) == (Control.WAITING, "nobody subscribes to /cmd")
        reader = node.reader("rt/cmd", idl_type(name))
        until(lambda: vehicle.status(now).control is Control.IN_CONTROL, "a subscriber")
        vehicle.send(None, now)
        vehicle.send((1.0, 0.5, -0.25, 2.0), now)
        sent = until(lambda: reader.take(10), "a set-point")
        assert len(sent) == 1, "for None nothing is sent"
        if kind == "twist_stamped":
            assert sent[0].header.frame_id == "base_link" and abs(sent[0].header.stamp.sec - time.time()) < 5
        assert same(sent[0] if kind == "twist" else sent[0].twist, twist_of((1.0, 0.5, -0.25, 2.0)))
        lost = vehicle.status(now + 1.5)
        assert lost.control is Control.LOST and "no odometry on /odom for 1.5 s" in lost.sentence


def test_a_kind_of_message_that_there_is_not_is_refused() -> None:
    with pytest.raises(UavrlError, match="kind must be one of twist, twist_stamped, got 'px4'"):
        Ros2Vehicle(kind="px4")


def test_px4_is_flown_while_it_is_armed_and_in_offboard(node: RosNode) -> None:
    odometries = node.writer("rt/a/fmu/out/vehicle_odometry", idl_type(PX4_ODOMETRY), reliable=False, transient=True)
    modes = node.writer("rt/a/fmu/out/vehicle_control_mode", idl_type(PX4_CONTROL_MODE), reliable=False, transient=True)
    setpoints = node.reader("rt/a/fmu/in/trajectory_setpoint", idl_type(PX4_SETPOINT), reliable=False)
    signs = node.reader("rt/a/fmu/in/offboard_control_mode", idl_type(PX4_OFFBOARD), reliable=False)
    with Px4Ros2(f"ros2://{DOMAIN}/a/fmu") as vehicle:
        until(lambda: odometries.get_matched_subscriptions() and modes.get_matched_subscriptions(), "a match")
        assert vehicle.status(0.0).control is Control.WAITING
        vehicle.send((1.0, 0.0, 0.0, 0.5), 0.0)  # nothing, as there is no yaw

        def control(armed: bool, offboard: bool) -> Control:
            modes.write(px4_mode(armed=armed, offboard=offboard))
            time.sleep(0.03)
            vehicle.receive(time.monotonic())
            return vehicle.status(time.monotonic()).control

        assert control(True, False) is Control.OTHER_MODE and control(False, True) is Control.DISARMED
        assert control(True, True) is Control.IN_CONTROL and control(True, False) is Control.TAKEN_OVER
        assert vehicle.status(time.monotonic() + 3.5).control is Control.LOST

        def posed() -> Pose | None:
            odometries.write(px4_odometry((1.0, 2.0, -3.5), 0.0, time.time_ns() // 1000))
            vehicle.receive(time.monotonic())
            return vehicle.pose()

        pose = until(posed, "a pose")
        assert pose.position == (2.0, 1.0, 3.5) and time.monotonic() - pose.stamp < 0.1
        vehicle.send(None, 0.0)
        vehicle.send((1.0, 0.25, 0.5, 0.5), 0.0)  # it heads north
        (told,) = until(lambda: setpoints.take(10), "a set-point")
        (sign,) = until(lambda: signs.take(10), "a sign of life")
        assert told.velocity == pytest.approx([1.0, -0.25, -0.5]) and told.yawspeed == -0.5
        others = (sign.position, sign.acceleration, sign.attitude, sign.body_rate, sign.thrust_and_torque)
        assert sign.velocity and not any(others) and not sign.direct_actuator
        assert told.timestamp == sign.timestamp and abs(told.timestamp * 1e-6 - time.time()) < 5.0


def test_a_node_that_is_closed_leaves_no_thread(node: RosNode) -> None:
    before = threading.active_count()
    with Node(DOMAIN) as closed:
        closed.reads("/odom", ODOMETRY)
        closed.start()
        assert threading.active_count() == before + 1
    closed.close()
    assert threading.active_count() == before


def test_of_two_writers_the_first_is_heard_until_it_falls_silent(
    node: RosNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavrl.deploy.dds.SILENCE", 0.1)
    first, second = (node.writer("rt/points", idl_type(CLOUD)) for _ in range(2))
    with Ros2Scans(f"ros2://{DOMAIN}/points") as scans:
        assert scans.trouble().startswith("no message has come on /points: does a node in this domain")
        until(lambda: first.get_matched_subscriptions() and second.get_matched_subscriptions(), "a match")
        first.write(cloud(np.ones((2, 3), np.float32), 1.0))
        until(lambda: scans.poll(0.0), "the first's cloud")
        second.write(cloud(np.ones((3, 3), np.float32), 2.0))
        time.sleep(0.05)
        assert scans.poll(0.0) is None
        time.sleep(0.1)
        second.write(cloud(np.ones((3, 3), np.float32), 3.0))
        assert until(lambda: scans.poll(0.0), "the second's cloud").rays == 3
