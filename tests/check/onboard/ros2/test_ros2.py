"""Scans and odometry from one process to another and set-points back, over DDS on the loopback device."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from uavrl_onboard.lidar.ros_messages import CLOUD, ODOMETRY, PX4_ODOMETRY, PX4_OFFBOARD, PX4_SETPOINT, TWIST
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.ros2.dds import idl_type

pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")

from tests.helpers.folders import ROOT
from tests.helpers.measured import measured
from tests.helpers.ros2_follower import SETPOINT
from tests.helpers.ros2_peer import DOMAIN, LOOPBACK, RosNode, cloud, odometry, px4_odometry

pytestmark = measured

SCANS = 20


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> RosNode:
    """This process's side, and the environment of the other's."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    return RosNode(DOMAIN)


@contextmanager
def repeated(action: Callable[[], None], period: float) -> Iterator[None]:
    """Does something again and again, beside."""
    ended = threading.Event()

    def loop() -> None:
        while not ended.wait(period):
            action()

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def follow(kind: str) -> list[dict[str, Any]]:
    """What the other process tells of its scans."""
    command = [sys.executable, "-m", "tests.helpers.ros2_follower", kind, str(DOMAIN), str(SCANS)]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    return [json.loads(line) for line in ended.stdout.splitlines()]


def check_told(told: list[dict[str, Any]], control: str) -> None:
    """Of a full scan at 10 Hz, beside a test that keeps this machine busy."""
    assert [(each["points"], round(each["nearest"], 5)) for each in told] == [(28928, 3.0)] * SCANS
    assert {tuple(each["position"]) for each in told} == {(1.0, 2.0, 3.5)}
    assert all(each["yaw"] == pytest.approx(0.5) for each in told) and told[-1]["control"] == control
    assert 0.0 <= np.median([each["scan_age"] for each in told]) < 0.1
    assert 0.0 <= np.median([each["pose_age"] for each in told]) < 0.1


def test_a_vehicle_that_takes_a_twist(node: RosNode) -> None:
    clouds = node.writer("rt/velodyne_points", idl_type(CLOUD), reliable=False)
    odometries = node.writer("rt/odom", idl_type(ODOMETRY))
    setpoints = node.reader("rt/cmd_vel", idl_type(TWIST))
    points = (3.0 * firing_directions()).astype(np.float32)
    with (
        repeated(lambda: clouds.write(cloud(points, time.time())), 0.1),
        repeated(lambda: odometries.write(odometry((1.0, 2.0, 3.5), 0.5, time.time())), 0.02),
    ):
        check_told(follow("twist"), "in_control")
    received = setpoints.take(SCANS)
    assert received
    for twist in received:
        if twist.sample_info.valid_data:
            linear = (twist.linear.x, twist.linear.y, twist.linear.z)
            assert (*linear, twist.angular.z) == SETPOINT


def test_px4_whose_messages_are_longer_than_what_is_read_of_them(node: RosNode) -> None:
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl.types import uint64

    flags = ["flag_armed", *(f"flag_{n}" for n in range(3)), "flag_offboard", *(f"flag_{n}" for n in range(5, 15))]
    whole = make_idl_struct(  # of px4_msgs 1.17
        "VehicleControlMode_",
        "px4_msgs.msg.dds_.VehicleControlMode_",
        {"timestamp": uint64, **dict.fromkeys(flags, bool)},
    )
    in_offboard = whole(0, *[flag in ("flag_armed", "flag_offboard") for flag in flags])
    clouds = node.writer("rt/velodyne_points", idl_type(CLOUD), reliable=False)
    out = {"reliable": False, "transient": True}
    odometries = node.writer("rt/fmu/out/vehicle_odometry", idl_type(PX4_ODOMETRY), **out)
    modes = node.writer("rt/fmu/out/vehicle_control_mode", whole, **out)
    setpoints = node.reader("rt/fmu/in/trajectory_setpoint", idl_type(PX4_SETPOINT), reliable=False)
    signs = node.reader("rt/fmu/in/offboard_control_mode", idl_type(PX4_OFFBOARD), reliable=False)
    points = (3.0 * firing_directions()).astype(np.float32)
    where = (2.0, 1.0, -3.5), np.pi / 2 - 0.5

    def tell() -> None:
        odometries.write(px4_odometry(*where, time.time_ns() // 1000))
        modes.write(in_offboard)

    with repeated(lambda: clouds.write(cloud(points, time.time())), 0.1), repeated(tell, 0.02):
        check_told(follow("px4"), "in_control")
    received = [each for each in setpoints.take(SCANS) if each.sample_info.valid_data]
    forward, left, up, turn = SETPOINT
    east, north = forward * np.cos(0.5) - left * np.sin(0.5), forward * np.sin(0.5) + left * np.cos(0.5)
    assert received and signs.take(SCANS)
    for message in received:
        assert message.velocity == pytest.approx([north, east, -up], abs=1e-6) and message.yawspeed == -turn
