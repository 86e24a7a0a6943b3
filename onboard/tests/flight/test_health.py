"""What is told of scans and poses that are whole, and odd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.flight.health import FlightHealth
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.safety import Reason, SafetyState, SafetyStatus
from uavrl_onboard.lidar.scans import Scan

WALL, NOTHING = np.array([[3.0, 0.0, 0.0]], np.float32), np.full((5, 3), np.nan, np.float32)


def cycle(
    time: float, points: np.ndarray | None, age: float | None = 0.0, control: Control = Control.IN_CONTROL
) -> FlightCycle:
    """One with a scan or without, and with a pose of some age or without."""
    pose = None if age is None else Pose(time - age, (0.0, 0.0, 2.0), (0.0, 0.0, 0.0), 0.0)
    scan = None if points is None else Scan(time, points, 1, 0)
    status = SafetyStatus(time, SafetyState.FLYING, Reason.IN_CONTROL, "", False, 0.0, None, (), None, None)
    return FlightCycle(time, scan, None, pose, None, None, VehicleStatus(control, "says the test"), status, None)


def told(*cycles: FlightCycle) -> list[str]:
    health = FlightHealth(lambda: "the test says so.", 10.0)
    return [sentence for each in cycles for sentence in health.sentences(each)]


@pytest.mark.parametrize("rate", [9.0, 10.0, 10.2])
def test_nothing_is_odd(rate: float) -> None:
    assert told(*(cycle(number / rate, WALL if number % 19 else NOTHING) for number in range(60))) == []


def test_a_sensor_that_turns_too_slowly() -> None:
    assert told(*(cycle(number / 5, WALL) for number in range(60))) == [
        "Scans come 5.0 times a second, and the policy has learned 10: "
        "look at the sensor's rate, at what is lost on the way, and at the processor's load."
    ]


def test_a_silence_is_no_slow_sensor() -> None:
    times = [number / 10 for number in range(15)] + [4.0 + number / 10 for number in range(30)]
    assert told(*(cycle(time, WALL) for time in times)) == []


def test_a_lasting_silence_is_told_twice_a_minute_and_its_end() -> None:
    silent = [cycle(0.1 * number, None) for number in range(650)]
    assert told(*silent, *(cycle(65.0 + 0.1 * number, WALL) for number in range(30))) == [
        "No scan has come for 3 s: the test says so.",
        "No scan has come for 33 s: the test says so.",
        "No scan has come for 63 s: the test says so.",
        "Scans come again; none had come for 65 s.",
    ]


def test_poses_of_a_sender_that_is_too_slow() -> None:
    """It holds 0.8 of real time for 40 s, then makes up for 0.1 s a second, and for a moment is just in time."""
    ages = [0.02 * number for number in range(400)] + [8.0 - 0.01 * number for number in range(790)]
    ages += [0.11, 0.09] * 10 + [0.02] * 20
    said = told(*(cycle(0.1 * number, WALL, age) for number, age in enumerate(ages)))
    assert said[0] == (
        "Poses are 0.7 s old, and nothing is flown by one older than 0.1 s: their sender's clock is slower than ours, "
        "as a starved simulator's is, or they wait on their way; look at the sender, its rate, and the processor's "
        "load (a second makes up for 0.1 s at most)."
    )
    assert [sentence.partition(",")[0] for sentence in said[1:4]] == [
        "Poses are 6.7 s old",
        "Poses are 5.6 s old",
        "Poses are 2.6 s old",
    ]
    assert said[4:] == ["Poses are in time again; they were missing or too old for 120 s."]


@pytest.mark.parametrize(
    ("control", "look"),
    [
        (Control.WAITING, "the autopilot runs, whether it sends to this address, and at its link"),
        (Control.LOST, "the autopilot runs, whether it sends to this address, and at its link"),
        (Control.OTHER_MODE, "the autopilot's estimator has a position, whether it sends both, and at its link"),
    ],
)
def test_poses_that_do_not_come(control: Control, look: str) -> None:
    why = f", so nothing is flown (says the test): look whether {look}."
    never = (cycle(0.1 * number, WALL, None, control) for number in range(60))
    assert told(*never) == [f"No position and attitude have come for 3 s{why}"]
    ceased = (cycle(0.1 * number, WALL, max(0.1 * number - 2.0, 0.0), control) for number in range(60))
    assert told(*ceased) == [f"No new position and attitude have come for 3 s{why}"]


def test_what_is_late_for_a_moment_is_not_told() -> None:
    ages = ([0.0] * 30 + [2.0] * 20) * 3
    assert told(*(cycle(0.1 * number, WALL, age) for number, age in enumerate(ages))) == []


def test_no_scan_at_all() -> None:
    assert told(*(cycle(0.12 * number, None) for number in range(60))) == [
        "No scan has come for 3 s: the test says so."
    ]


@pytest.mark.parametrize("age", [0.19, 0.22])
def test_scans_whose_stamp_is_steadily_old_have_a_cause(age: float) -> None:
    """A driver that stamps the first point: flying, holding and silent take turns, or there is silence for ever."""
    cycles = [replace(cycle(0.1 * number, WALL), scan=Scan(0.1 * number - age, WALL, 1, 0)) for number in range(60)]
    asks = f"Scans are {age:.2f} s old when they arrive: "
    header = "is header.stamp that of the first point? It must be that of the last one."
    waits = "look at the processor's load, and at what holds packets up on their way."
    for stamped, cause in ((True, header), (False, waits)):
        health = FlightHealth(lambda: "", 10.0, stamped=stamped)
        assert [sentence for each in cycles for sentence in health.sentences(each)] == [asks + cause]


@pytest.mark.parametrize("age", [0.0, 0.03, 0.07])
def test_scans_that_take_their_time_are_not_told(age: float) -> None:
    cycles = [replace(cycle(0.1 * number, WALL), scan=Scan(0.1 * number - age, WALL, 1, 0)) for number in range(60)]
    cycles[30] = replace(cycle(3.0, WALL), scan=Scan(2.7, WALL, 1, 0))
    assert told(*cycles) == []


def test_poses_whose_stamp_is_steadily_old_have_a_cause() -> None:
    assert told(*(cycle(0.1 * number, WALL, 0.07 + 0.02 * (number % 2)) for number in range(60))) == [
        "Poses are 0.07 s old or older whenever a scan comes: is their stamp that of an earlier measurement, or do "
        "they come less than 20 times a second?"
    ]
    assert told(*(cycle(0.1 * number, WALL, 0.03 * (number % 4)) for number in range(60))) == []


def test_what_is_odd_about_scans_and_their_source_is_told_once() -> None:
    health = FlightHealth(lambda: "", 10.0, remarks=lambda: ["Two senders."])
    cycles = [replace(cycle(0.1 * number, WALL), doubt="no return has ever come: why?") for number in range(5)]
    said = [sentence for each in cycles for sentence in health.sentences(each)]
    assert said == ["Two senders.", "No return has ever come: why?"]
