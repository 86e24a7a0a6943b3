"""PX4 by its topics in ROS 2: frames and signs, and who flies."""

from __future__ import annotations

import math
import time
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.helpers.ros2_peer import DOMAIN, LOOPBACK, RosNode, px4_mode, px4_odometry, until

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.lidar.ros_messages import PX4_CONTROL_MODE, PX4_ODOMETRY, PX4_OFFBOARD, PX4_SETPOINT
from uavrl_onboard.ros2.dds import idl_type
from uavrl_onboard.ros2.px4 import Px4Ros2, px4_pose, px4_setpoint

pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> RosNode:
    """Another node, on this machine alone."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    return RosNode(DOMAIN)


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


@pytest.mark.parametrize(
    ("q", "roll", "pitch", "yaw"),
    [  # w, x, y, z, from forward, right, down to north, east, down
        ((math.cos(0.1), 0.0, math.sin(0.1), 0.0), 0.0, -0.2, math.pi / 2),  # heads north, nose up
        ((math.cos(0.1), math.sin(0.1), 0.0, 0.0), 0.2, 0.0, math.pi / 2),  # heads north, right side down
        ((0.5, 0.5, 0.5, 0.5), math.pi / 2, 0.0, 0.0),  # heads east, and lies on its right side
    ],
)
def test_px4_s_attitude_has_roll_and_pitch(q: tuple[float, ...], roll: float, pitch: float, yaw: float) -> None:
    message = px4_odometry((1.0, 2.0, -3.5), 0.0, 0)
    message.q = list(q)
    pose = px4_pose(message, 5.0)
    assert (pose.roll, pose.pitch, pose.yaw) == pytest.approx((roll, pitch, yaw), abs=1e-12)


def test_px4_s_attitude_is_the_one_that_scipy_computes() -> None:
    swap = np.array(
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
    )  # of the world; the body's turns about forward
    message = px4_odometry((1.0, 2.0, -3.5), 0.0, 0)
    for turn in Rotation.random(30, rng=np.random.default_rng(0)):
        x, y, z, w = turn.as_quat()
        message.q = [w, x, y, z]
        w, *axis = px4_pose(message, 5.0).rotation
        wanted = swap @ turn.as_matrix() @ np.diag([1.0, -1.0, -1.0])
        np.testing.assert_allclose(Rotation.from_quat([*axis, w]).as_matrix(), wanted, atol=1e-9)


def test_px4_s_odometry_in_another_frame_is_no_pose() -> None:
    pose = px4_pose(px4_odometry((1.0, 2.0, -3.5), 0.0, 0, frame=2, velocity_frame=2), 5.0)
    assert np.isnan([*pose.position, *pose.velocity, pose.yaw, pose.roll, pose.pitch]).all()


def test_px4_is_flown_while_it_is_armed_and_in_offboard(node: RosNode) -> None:
    odometries = node.writer("rt/a/fmu/out/vehicle_odometry", idl_type(PX4_ODOMETRY), reliable=False, transient=True)
    modes = node.writer("rt/a/fmu/out/vehicle_control_mode", idl_type(PX4_CONTROL_MODE), reliable=False, transient=True)
    setpoints = node.reader("rt/a/fmu/in/trajectory_setpoint", idl_type(PX4_SETPOINT), reliable=False)
    signs = node.reader("rt/a/fmu/in/offboard_control_mode", idl_type(PX4_OFFBOARD), reliable=False)
    with Px4Ros2(f"ros2://{DOMAIN}/a/fmu") as vehicle:
        until(lambda: odometries.get_matched_subscriptions() and modes.get_matched_subscriptions(), "a match")
        assert vehicle.status(0.0).control is Control.WAITING
        vehicle.send((1.0, 0.0, 0.0, 0.5), 0.0)  # nothing, as there is no yaw

        def controlled(wanted: Control) -> bool:
            vehicle.receive(time.monotonic())
            return vehicle.status(time.monotonic()).control is wanted

        for armed, offboard, wanted in (
            (True, False, Control.OTHER_MODE),
            (False, True, Control.DISARMED),
            (True, True, Control.IN_CONTROL),
            (True, False, Control.TAKEN_OVER),
        ):
            modes.write(px4_mode(armed=armed, offboard=offboard))
            until(partial(controlled, wanted), wanted.value)
        assert vehicle.status(time.monotonic() + 3.5).control is Control.LOST

        def posed() -> Pose | None:
            odometries.write(px4_odometry((1.0, 2.0, -3.5), 0.0, time.time_ns() // 1000))
            vehicle.receive(time.monotonic())
            return vehicle.pose()

        begun = time.monotonic()
        pose = until(posed, "a pose")
        assert pose.position == (2.0, 1.0, 3.5) and begun - 0.01 < pose.stamp <= time.monotonic()
        vehicle.send(None, 0.0)
        vehicle.send((1.0, 0.25, 0.5, 0.5), 0.0)  # it heads north
        (told,) = until(lambda: setpoints.take(10), "a set-point")
        (sign,) = until(lambda: signs.take(10), "a sign of life")
        assert told.velocity == pytest.approx([1.0, -0.25, -0.5]) and told.yawspeed == -0.5
        others = (sign.position, sign.acceleration, sign.attitude, sign.body_rate, sign.thrust_and_torque)
        assert sign.velocity and not any(others) and not sign.direct_actuator
        assert told.timestamp == sign.timestamp and abs(told.timestamp * 1e-6 - time.time()) < 5.0
