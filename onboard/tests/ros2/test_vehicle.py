"""ROS 2 without ROS: frames and signs, ages, states. Nodes meet within this process."""

from __future__ import annotations

import math
import select
import sys
import threading
import time
from contextlib import closing

import numpy as np
import pytest
from tests.helpers.ros2_peer import DOMAIN, LOOPBACK, RosNode, cloud, odometry, same, until

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.ros_messages import CLOUD, ODOMETRY, TWIST
from uavrl_onboard.ros2.dds import Arrived, Node, check_topic, idl_type, topic_of
from uavrl_onboard.ros2.vehicle import Ros2Scans, Ros2Vehicle, Stamps, pose_of, twist_of

pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")


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
    pose = pose_of(message, 0.0)
    assert np.isnan([pose.yaw, pose.roll, pose.pitch]).all()


def test_an_odometry_s_orientation_has_the_angles_that_pybullet_gives_it() -> None:
    message = odometry((1.0, 2.0, 3.5), 0.0, 0.0)
    turn, told = message.pose.pose.orientation, (-0.25, 0.5, 2.0)  # roll, pitch, yaw about fixed axes, as in REP 103
    # pybullet.getQuaternionFromEuler(told)
    turn.x, turn.y, turn.z, turn.w = -0.27182686127512884, 0.030981201448547494, 0.8256159934416316, 0.49346585902117307
    pose = pose_of(message, 7.0)
    assert (pose.roll, pose.pitch, pose.yaw) == pytest.approx(told)
    nose_down = message.pose.pose.orientation.__class__(0.0, math.sin(0.25), 0.0, math.cos(0.25))
    message.pose.pose.orientation = nose_down
    assert pose_of(message, 7.0).pitch == pytest.approx(0.5)


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
    assert Stamps("/odom").of(made, arrived(1000.0, 50.0, sent=999.99)) == pytest.approx(stamp)


def test_a_message_that_waited_is_old_whatever_its_clock() -> None:
    stamps = Stamps("/odom")
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
    with pytest.raises(UavrlError, match=r"cyclonedds: pip install 'uavrl-onboard\[ros2\]'\. On Linux for ARM"):
        Ros2Scans()


def test_a_domain_that_cannot_be_entered_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = '<NetworkInterface address="203.0.113.9"/>'
    monkeypatch.setenv(
        "CYCLONEDDS_URI", LOOPBACK.replace('<NetworkInterface address="127.0.0.1" multicast="false"/>', nowhere)
    )
    with pytest.raises(UavrlError, match=r"domain \d+ of ROS 2 cannot be entered .*does CYCLONEDDS_URI fit it\?"):
        Ros2Scans(f"ros2://{DOMAIN}/points")


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
        begun, made = time.monotonic(), time.time() - 0.05
        writer.write(cloud(points, made))
        scan = until(lambda: scans.poll(0.0), "a scan")
        np.testing.assert_array_equal(scan.points, points)
        assert (scan.rays, scan.misses) == (4, 2)
        age, waited = time.monotonic() - scan.stamp, time.monotonic() - begun
        assert 0.049 < age < 0.06 + 2.0 * waited, "as old as its header says"
        writer.write(cloud(points, made))  # sent again: it is no new scan
        until(lambda: scans.poll(0.0) or scans.skipped.late_messages, "the repetition")
        broken = cloud(points, made + 0.1)
        broken.data = broken.data[:40]
        writer.write(broken)
        until(lambda: scans.poll(0.0) or scans.skipped.malformed, "the broken cloud")
        assert scans.skipped.sentences() == [
            "1 message no newer than the one before",
            "1 message that could not be read",
        ]


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
        begun = time.monotonic()
        writer.write(odometry((1.0, 2.0, 3.5), 0.5, time.time()))

        def posed() -> Pose | None:
            vehicle.receive(time.monotonic())
            return vehicle.pose()

        pose = until(posed, "a pose")
        assert pose.position == (1.0, 2.0, 3.5) and pose.yaw == pytest.approx(0.5)
        now = time.monotonic()
        assert begun - 0.01 < pose.stamp <= now
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


def test_a_node_that_is_closed_leaves_no_thread(node: RosNode) -> None:
    before = threading.active_count()
    with closing(Node(DOMAIN)) as closed:
        closed.reads("/odom", ODOMETRY)
        closed.start()
        assert threading.active_count() == before + 1
    closed.close()
    assert threading.active_count() == before


def test_of_two_writers_the_first_is_heard_until_it_falls_silent(
    node: RosNode, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def shared() -> list[str]:
        return [record.getMessage() for record in caplog.records if record.name == "uavrl_onboard.ros2.dds"]

    monkeypatch.setattr("uavrl_onboard.ros2.dds.SILENCE", 600.0)
    first, second = (node.writer("rt/points", idl_type(CLOUD)) for _ in range(2))
    with Ros2Scans(f"ros2://{DOMAIN}/points") as scans:
        assert scans.trouble().startswith("no message has come on /points: does a node in this domain")
        until(lambda: first.get_matched_subscriptions() and second.get_matched_subscriptions(), "a match")
        first.write(cloud(np.ones((2, 3), np.float32), 1.0))
        until(lambda: scans.poll(0.0), "the first's cloud")
        monkeypatch.setattr("uavrl_onboard.ros2.vehicle.SILENCE", 0.0)
        assert scans.trouble().startswith("no message has come on /points for 0 s, where there were some")
        second.write(cloud(np.ones((3, 3), np.float32), 2.0))
        time.sleep(0.05)
        assert scans.poll(0.0) is None and not shared(), "a driver that has started again may be so early"
        for stamp in (2.1, 2.2):
            first.write(cloud(np.ones((2, 3), np.float32), stamp))
            assert until(lambda: scans.poll(0.0), "the first's next cloud").rays == 2
            second.write(cloud(np.ones((3, 3), np.float32), stamp + 0.05))
            time.sleep(0.05)
        told = "Two nodes publish on /points: only the first is read. Give each a topic of its own."
        assert shared() == [told], "once"
        monkeypatch.setattr("uavrl_onboard.ros2.dds.SILENCE", 0.02)
        time.sleep(0.1)
        second.write(cloud(np.ones((3, 3), np.float32), 3.0))
        assert until(lambda: scans.poll(0.0), "the second's cloud").rays == 3


def test_a_cloud_in_the_world_s_frame_is_refused(node: RosNode) -> None:
    clouds, odometries = node.writer("rt/cloud_registered", idl_type(CLOUD)), node.writer("rt/odom", idl_type(ODOMETRY))
    points = np.ones((3, 3), np.float32)
    with (
        Ros2Vehicle(f"ros2://{DOMAIN}/odom") as vehicle,
        Ros2Scans(f"ros2://{DOMAIN}/cloud_registered", vehicle) as scans,
    ):
        until(lambda: clouds.get_matched_subscriptions() and odometries.get_matched_subscriptions(), "a match")
        odometries.write(odometry((1.0, 2.0, 3.5), 0.5, 1.0, frame="lidar_init"))
        until(lambda: [vehicle.receive(0.0), vehicle.world_frame][1], "the odometry")
        for number, name in enumerate(("lidar_init", "/lidar_init", "map", "velodyne", "lidar_init", "camera"), 1):
            clouds.write(cloud(points, float(number), frame=name))
            refused = scans.skipped.other_frame
            scan = until(lambda: scans.poll(0.0) or scans.skipped.other_frame > refused, f"the cloud in {name}")  # noqa: B023
            assert (scan is True) == (name != "velodyne"), name
            if name == "lidar_init":
                assert (
                    "cannot be used: they are in the frame lidar_init, which is fixed to the world" in scans.trouble()
                )
        assert "their frame changed from velodyne to camera" in scans.trouble()
        clouds.write(cloud(points, 9.0, frame="velodyne"))
        until(lambda: scans.poll(0.0), "a cloud of the sensor")
        assert scans.skipped.sentences() == ["5 messages in another frame than the sensor's"]


def test_an_odometry_whose_frame_changes_is_no_pose(node: RosNode) -> None:
    writer = node.writer("rt/odom", idl_type(ODOMETRY))
    with Ros2Vehicle(f"ros2://{DOMAIN}/odom") as vehicle:
        until(lambda: writer.get_matched_subscriptions(), "a match")
        for number, (name, x) in enumerate((("odom", 1.0), ("map", 7.0), ("odom", 2.0), ("", 8.0))):
            writer.write(odometry((x, 0.0, 3.5), 0.0, 1.0 + number, frame=name))
            assert select.select([vehicle], [], [], 10.0)[0]
            vehicle.receive(0.0)
            pose = vehicle.pose()
            assert pose is not None and pose.position[0] == (x if name == "odom" else pose.position[0]) < 5.0
        lost = vehicle.status(time.monotonic() + 2.0)
    assert lost.control is Control.LOST and lost.sentence.endswith("because its frame changed from odom to none")
