"""What a simulated autopilot tells: frames, rates, and what it is asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from scipy.spatial.transform import Rotation

from uavrl.sitl.live import Motion
from uavrl.sitl.simulated_autopilot import SimulatedAutopilot
from uavrl.sitl.telemetry import RATES, Telemetry
from uavrl_onboard.autopilot.vehicle_state import AutopilotMonitor, Control

MOTION = Motion(
    position=np.array([2.0, 10.0, 3.5]),
    velocity=np.array([-0.5, 1.0, -0.25]),
    rotation=Rotation.from_euler("ZYX", [0.3, 0.1, -0.2]).as_matrix(),  # yaw left, nose down, left side down
    rates=np.array([0.1, 0.2, 0.3]),
)


def made(**options: bool) -> tuple[SimulatedAutopilot, Telemetry]:
    pilot = SimulatedAutopilot(common, "px4", **options)
    return pilot, Telemetry(common, pilot)


def test_the_pose_comes_back_in_our_axes() -> None:
    _, telemetry = made()
    vehicle = AutopilotMonitor()
    for message in telemetry.due(7.0, MOTION):
        message._header = common.MAVLink_header(message.id, srcSystem=1, srcComponent=1)
        vehicle.hear(message, 7.0)
    pose = vehicle.pose()
    assert pose is not None
    assert (pose.position, pose.velocity) == ((2.0, 10.0, 3.5), (-0.5, 1.0, -0.25))
    assert (pose.yaw, pose.pitch, pose.roll) == pytest.approx((0.3, 0.1, -0.2))
    assert vehicle.status(7.0).control is Control.OTHER_MODE and vehicle.status(7.0).mode == "AUTO.LOITER"


def test_attitude_to_the_right_nose_up_from_north() -> None:
    _, telemetry = made()
    attitude = telemetry.message(30, 1.5, MOTION)
    assert attitude.time_boot_ms == 1500
    told = (attitude.roll, attitude.pitch, attitude.yaw)
    np.testing.assert_allclose(told, (-0.2, -0.1, math.pi / 2 - 0.3), atol=1e-9)
    assert (attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed) == (0.1, -0.2, -0.3)
    four = telemetry.message(31, 1.5, MOTION)
    w, x, y, z = Rotation.from_euler("ZYX", told[::-1]).as_quat(scalar_first=True)
    np.testing.assert_allclose((four.q1, four.q2, four.q3, four.q4), (w, x, y, z), atol=1e-9)


def test_the_globe_says_the_same() -> None:
    _, telemetry = made()
    at = telemetry.message(33, 0.0, MOTION)
    north = math.radians(at.lat * 1e-7 - 47.397742) * 6_371_000
    east = math.radians(at.lon * 1e-7 - 8.545594) * 6_371_000 * math.cos(math.radians(47.397742))
    assert (north, east) == (pytest.approx(10.0, abs=0.02), pytest.approx(2.0, abs=0.02))
    assert (at.relative_alt, at.alt, at.vx, at.vy, at.vz) == (3500, 491_500, 100, -50, 25)
    assert at.hdg == round(math.degrees(math.pi / 2 - 0.3) * 100)


def test_rates_are_held_and_changed() -> None:
    _, telemetry = made()

    def counted(begin: float) -> dict[int, int]:
        sent = [message.get_msgId() for tick in range(320) for message in telemetry.due(begin + tick / 80, MOTION)]
        return {number: sent.count(number) for number in RATES}

    assert counted(0.0) == {number: pytest.approx(4 * rate, abs=1) for number, rate in RATES.items()}
    assert telemetry.set_interval(32, 100_000.0) and telemetry.set_interval(31, -1.0)
    counts = counted(4.0)
    assert (counts[32], counts[31]) == (pytest.approx(40, abs=1), 0)
    assert telemetry.set_interval(31, 0.0) and counted(8.0)[31] == pytest.approx(200, abs=1)
    assert not telemetry.set_interval(999, 1000.0)


def test_what_is_asked_for_comes_once() -> None:
    pilot, telemetry = made()
    telemetry.due(0.0, MOTION)
    assert pilot.request(148) and not pilot.request(999)
    assert [message.get_type() for message in telemetry.due(0.001, MOTION)] == ["AUTOPILOT_VERSION"]
    assert not telemetry.due(0.002, MOTION)


def test_all_messages_can_be_packed() -> None:
    _, telemetry = made(armed=False)
    writer = common.MAVLink(None, srcSystem=1, srcComponent=1)
    parser = common.MAVLink(None)
    for number in (*RATES, 148):
        (read,) = parser.parse_buffer(telemetry.message(number, 3e6, MOTION).pack(writer))
        assert read.get_msgId() == number
        if number == 0:
            assert (read.base_mode & 128, read.custom_mode, read.autopilot, read.type) == (0, 0x03040000, 12, 2)
