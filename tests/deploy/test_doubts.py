"""What is told of scans that are whole, and odd."""

from __future__ import annotations

import numpy as np
import pytest

from uavrl.deploy.doubts import Doubts
from uavrl.deploy.safety import Reason, SafetyStatus, State
from uavrl.deploy.scans import Scan
from uavrl.deploy.stages import FlightCycle
from uavrl.deploy.vehicle import Control, VehicleStatus

WALL, NOTHING = np.array([[3.0, 0.0, 0.0]], np.float32), np.full((5, 3), np.nan, np.float32)


def cycle(time: float, points: np.ndarray | None) -> FlightCycle:
    scan = None if points is None else Scan(time, points, 1, 0)
    status = SafetyStatus(time, State.FLYING, Reason.IN_CONTROL, "", False, 0.0, None, (), None, None)
    return FlightCycle(time, scan, None, None, None, None, VehicleStatus(Control.IN_CONTROL, ""), status, None)


def told(*cycles: FlightCycle) -> list[str]:
    doubts = Doubts(lambda: "the test says so.", 10.0)
    return [sentence for each in cycles for sentence in doubts.of(each)]


@pytest.mark.parametrize("rate", [9.0, 10.0, 10.2])
def test_nothing_is_odd(rate: float) -> None:
    assert told(*(cycle(number / rate, WALL if number % 19 else NOTHING) for number in range(60))) == []


@pytest.mark.parametrize("points", [NOTHING, np.zeros((0, 3), np.float32), np.zeros((4, 3), np.float32)])
def test_a_sensor_that_sees_nothing(points: np.ndarray) -> None:
    assert told(*(cycle(number / 10, points) for number in range(60))) == [
        "20 scans in a row hold no return at all: for the policy the way is free. "
        "Is the sensor covered, or its laser off?"
    ]


def test_a_sensor_that_turns_too_slowly() -> None:
    assert told(*(cycle(number / 5, WALL) for number in range(60))) == [
        "Scans come 5.0 times a second, and the policy has learned 10: "
        "look at the sensor's rate, and at what is lost on the way."
    ]


def test_a_silence_is_no_slow_sensor() -> None:
    times = [number / 10 for number in range(15)] + [4.0 + number / 10 for number in range(30)]
    assert told(*(cycle(time, WALL) for time in times)) == []


def test_no_scan_at_all() -> None:
    assert told(*(cycle(0.12 * number, None) for number in range(60))) == [
        "No scan has come for 3 s: the test says so."
    ]
