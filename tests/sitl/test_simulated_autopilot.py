"""The modes of a simulated PX4 and ArduPilot: what they refuse, obey and leave, by a clock of the test's own."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from tests.helpers.autopilot_peer import garbage
from uavrl.sitl.simulated_autopilot import FirmwareName, SimulatedAutopilot
from uavrl_onboard.autopilot.mavlink import BODY_NED, TYPE_MASK

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
SET_MODE, ARM = 176, 400


class Companion:
    """Sends to a simulated autopilot; its clock runs only when told."""

    def __init__(self, firmware: FirmwareName = "px4", **options: Any) -> None:
        self.time, self.pilot = 0.0, SimulatedAutopilot(common, firmware, **options)
        self.ours = (6.0, 0.0) if firmware == "px4" else (4.0, 0.0)

    def send(self, message: Any) -> list[Any]:
        """Gives a message; returns the answers."""
        message._header = common.MAVLink_header(message.id, srcSystem=1, srcComponent=191)
        self.pilot.hear(message, self.time, 0.0)
        answers, self.pilot.answers = self.pilot.answers, []
        return answers

    def command(self, number: int, *parameters: float, to: int = 1) -> int | None:
        """The MAV_RESULT of a command."""
        given = [*parameters, *[0.0] * (7 - len(parameters))]
        answers = self.send(common.MAVLink_command_long_message(to, 1, number, 0, *given))
        return next((each.result for each in answers if each.get_type() == "COMMAND_ACK"), None)

    def setpoint(self, forward: float = 1.0) -> None:
        none = (0.0, 0.0, 0.0)
        numbers = (*none, forward, 0.0, 0.0, *none, 0.0, 0.0)
        self.send(common.MAVLink_set_position_target_local_ned_message(0, 1, 1, BODY_NED, TYPE_MASK, *numbers))

    def stream(self, seconds: float, rate: float = 10.0) -> None:
        for _ in range(round(seconds * rate)):
            self.setpoint()
            self.wait(1.0 / rate)

    def wait(self, seconds: float) -> None:
        self.time += seconds
        self.pilot.tick(self.time)

    def take_off(self) -> None:
        """Sets the mode that obeys."""
        self.stream(1.2)
        assert self.command(SET_MODE, 1.0, *self.ours) == ACCEPTED


@pytest.mark.parametrize(
    ("seconds", "rate", "result"),
    [(0.0, 10.0, REJECTED), (0.5, 10.0, REJECTED), (3.0, 1.5, REJECTED), (1.2, 10.0, ACCEPTED)],
)
def test_offboard_needs_a_second_of_setpoints(seconds: float, rate: float, result: int) -> None:
    companion = Companion()
    companion.stream(seconds, rate)
    assert companion.command(SET_MODE, 1.0, 6.0, 0.0) == result
    assert companion.pilot.in_control is (result == ACCEPTED)
    assert companion.pilot.mode_name == ("OFFBOARD" if result == ACCEPTED else "AUTO.LOITER")


def test_a_stream_that_has_ended_is_none() -> None:
    companion = Companion()
    companion.stream(2.0)
    companion.wait(0.6)
    assert companion.command(SET_MODE, 1.0, 6.0, 0.0) == REJECTED


def test_offboard_is_left_a_second_after_the_last_setpoint_and_not_taken_again() -> None:
    companion = Companion()
    companion.take_off()
    companion.stream(0.5)
    assert companion.pilot.setpoint(companion.time) is not None
    companion.wait(0.85)
    assert companion.pilot.in_control
    companion.wait(0.1)
    assert companion.pilot.mode_name == "AUTO.LOITER"
    assert companion.pilot.setpoint(companion.time) is None
    companion.stream(2.0)
    assert companion.pilot.mode_name == "AUTO.LOITER"
    names = [(mode, reason) for _, mode, reason in companion.pilot.changes]
    assert names == [("AUTO.LOITER", "start"), ("OFFBOARD", "asked for"), ("AUTO.LOITER", "no set-point for 1 s")]


def test_ardupilot_stays_in_guided_and_stops_after_three_seconds() -> None:
    companion = Companion("ardupilot")
    assert companion.pilot.mode_name == "LOITER"
    assert companion.command(SET_MODE, 1.0, 4.0, 0.0) == ACCEPTED  # without a stream
    companion.setpoint()
    companion.wait(2.9)
    assert companion.pilot.setpoint(companion.time) is not None
    companion.wait(0.2)
    assert companion.pilot.setpoint(companion.time) is None and companion.pilot.mode_name == "GUIDED"
    companion.setpoint()
    assert companion.pilot.setpoint(companion.time) is not None


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_the_pilot_takes_the_mode_and_the_companion_may_ask_for_it_again(firmware: FirmwareName) -> None:
    companion = Companion(firmware)
    companion.take_off()
    companion.pilot.take_over(companion.time)
    assert companion.pilot.mode_name == ("POSCTL" if firmware == "px4" else "POSHOLD")
    companion.setpoint()
    assert companion.pilot.setpoint(companion.time) is None and companion.pilot.setpoints == 0
    assert companion.command(SET_MODE, 1.0, *companion.ours) == ACCEPTED
    companion.setpoint()
    assert companion.pilot.setpoints == 1


def test_setpoints_before_the_mode_and_without_motors_are_not_obeyed() -> None:
    companion = Companion(armed=False)
    companion.take_off()
    companion.setpoint()
    assert companion.pilot.setpoint(companion.time) is None and companion.pilot.setpoints == 0
    assert companion.command(ARM, 1.0) == ACCEPTED
    assert companion.pilot.setpoint(companion.time) is None  # the one before is gone
    companion.setpoint(0.5)
    target = companion.pilot.setpoint(companion.time)
    assert target is not None and target.body is not None and target.body.tolist() == [0.5, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(("firmware", "result"), [("px4", REJECTED), ("ardupilot", FAILED)])
def test_in_the_air_it_is_disarmed_by_force_alone(firmware: FirmwareName, result: int) -> None:
    companion = Companion(firmware)
    assert companion.command(ARM, 0.0) == result
    assert companion.pilot.armed and not companion.pilot.fell
    assert companion.command(ARM, 0.0, 21196.0) == ACCEPTED
    assert companion.pilot.fell and not companion.pilot.armed


@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        (SET_MODE, (1.0, 4.0, 5.0), DENIED),  # AUTO.RTL
        (SET_MODE, (1.0, 4.0, 3.0), ACCEPTED),  # AUTO.LOITER
        (SET_MODE, (0.0, 6.0, 0.0), DENIED),  # no custom mode
        (SET_MODE, (1.0, math.nan, math.inf), DENIED),
        (SET_MODE, (1.0, -7.0, 3e38), DENIED),
        (22, (0.0,), UNSUPPORTED),  # take off
    ],
)
def test_other_commands(number: int, parameters: tuple[float, ...], result: int) -> None:
    companion = Companion()
    assert companion.command(number, *parameters) == result
    assert companion.pilot.mode_name == "AUTO.LOITER"


def test_what_is_for_another_system_is_not_answered() -> None:
    companion = Companion()
    assert companion.command(ARM, 0.0, to=2) is None and companion.command(ARM, 1.0, to=0) == ACCEPTED


def test_what_it_refuses_is_said_once() -> None:
    companion = Companion()
    said = [
        each.text.rstrip("\0")
        for _ in range(3)
        for each in companion.send(common.MAVLink_set_position_target_local_ned_message(0, 1, 1, 7, 0, *[0.0] * 11))
    ]
    assert said == ["Set-points are obeyed in MAV_FRAME_LOCAL_NED and M"]


def test_the_old_message_for_a_mode() -> None:
    companion = Companion()
    companion.stream(1.2)
    companion.send(common.MAVLink_set_mode_message(1, 1, 6 << 16))
    assert companion.pilot.in_control


def test_random_messages_raise_nothing() -> None:
    rng, companion = random.Random(0), Companion()
    parser = common.MAVLink(None)
    parser.robust_parsing = True

    class Sender:
        messages = common.MAVLink(None)

    for _ in range(500):
        for message in parser.parse_buffer(garbage(Sender, rng)) or []:  # type: ignore[arg-type]
            companion.pilot.hear(message, companion.time, 0.0)
    wild = [math.nan, math.inf, -1e38, 2.0**31, -1.0, 0.5, 1.0, 6.0, 1e9]
    for _ in range(2000):
        companion.command(rng.choice([SET_MODE, ARM, 511, 512, 520, 22]), *(rng.choice(wild) for _ in range(7)))
        companion.wait(0.01)
