"""The safety layer: each rule by its name, and what holds whatever comes in."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.limits import SafetyLimits, limit
from uavrl_onboard.flight.safety import ZEROS, Cycle, Reason, SafetyLayer, SafetyState, SafetyStatus

START = 100.0  # of the clock, s


class SteppedLayer:
    """Steps a safety layer ten times a second; what is not said otherwise is as it should be."""

    def __init__(self, limits: SafetyLimits | None = None) -> None:
        self.layer = SafetyLayer(limits)
        self.cycle = 0

    def step(self, *, scan_age: float | None = 0.0, pose_age: float | None = 0.02, **changes: Any) -> SafetyStatus:
        now = START + self.cycle / 10
        self.cycle += 1
        as_it_should_be = Cycle(
            now=now,
            action=(0.5, -0.5, 0.25, 0.1),
            scan_stamp=None if scan_age is None else now - scan_age,
            pose_stamp=None if pose_age is None else now - pose_age,
            position=(0.0, 0.0, 3.5),
            yaw=0.0,
            in_control=True,
        )
        return self.layer.step(replace(as_it_should_be, **changes))

    def steps(self, count: int, **changes: Any) -> list[SafetyStatus]:
        return [self.step(**changes) for _ in range(count)]


@pytest.fixture
def flying() -> SteppedLayer:
    flight = SteppedLayer()
    assert flight.steps(12)[-1].state is SafetyState.FLYING
    return flight


def names(statuses: list[SafetyStatus]) -> list[tuple[str, str]]:
    """State and reason of each change."""
    return [(str(status.state), str(status.reason)) for status in statuses if status.changed]


def test_nothing_is_sent_before_all_rules_have_held_for_a_second() -> None:
    flight = SteppedLayer()
    started = [*flight.steps(3, scan_age=None), *flight.steps(12, in_control=False), *flight.steps(1)]
    assert names(started) == [
        ("silent", "no_scan"),
        ("silent", "settling"),
        ("standby", "settling"),
        ("standby", "not_in_control"),
        ("flying", "in_control"),
    ]
    assert [status.setpoint for status in started[:13]] == [None] * 13
    assert [status.setpoint for status in started[13:15]] == [ZEROS] * 2
    assert started[-1].setpoint == (0.5, -0.5, 0.25, 0.1)
    assert started[-1].since == started[-1].time


FAULTS = {
    Reason.NO_SCAN: {"scan_age": None},
    Reason.OLD_SCAN: {"scan_age": 0.21},
    Reason.SCAN_AHEAD: {"scan_age": -0.1},
    Reason.NO_POSE: {"pose_age": None},
    Reason.OLD_POSE: {"pose_age": 0.5},
    Reason.POSE_AHEAD: {"pose_age": -0.1},
    Reason.POSE_NOT_FINITE: {"position": (0.0, math.nan, 3.5)},
    Reason.OUTSIDE_FENCE: {"position": (0.0, 0.0, 5.6)},
    Reason.NO_ACTION: {"action": None},
    Reason.ACTION_NOT_FINITE: {"action": (0.0, math.inf, 0.0, 0.0)},
    Reason.CLOCK: {"now": math.nan},
}


@pytest.mark.parametrize("reason", FAULTS)
def test_a_broken_rule_stops_the_vehicle_at_once_and_is_named(flying: SteppedLayer, reason: Reason) -> None:
    status = flying.step(**FAULTS[reason])
    assert (status.state, status.reason, status.changed) == (SafetyState.HOLDING, reason, True)
    assert status.setpoint == ZEROS
    assert status.sentence


@pytest.mark.parametrize("reason", [reason for reason in FAULTS if reason is not Reason.CLOCK])
def test_zeros_for_half_a_second_and_then_silence(flying: SteppedLayer, reason: Reason) -> None:
    statuses = flying.steps(8, **FAULTS[reason])
    assert [status.setpoint for status in statuses] == [ZEROS] * 5 + [None] * 3
    assert names(statuses) == [("holding", reason), ("silent", reason)]
    assert statuses[5].time - statuses[0].time == pytest.approx(0.5)


@pytest.mark.parametrize(
    "known",
    [
        {"scan_age": 0.2},
        {"pose_age": 0.1},
        {"position": (0.0, 0.0, 5.4)},
        {"position": (1e9, -1e9, 3.5)},
        {"action": np.float32([0.1, 0.2, 0.3, 0.4])},
        {"action": [0, 1, 0, 1]},
    ],
)
def test_what_is_just_within_the_rules_flies(flying: SteppedLayer, known: dict[str, Any]) -> None:
    assert flying.step(**known).state in (SafetyState.FLYING, SafetyState.FENCED)


@pytest.mark.parametrize("action", [(1.0, 2.0), np.zeros((1, 4)), "abcd", [1j, 0, 0, 0], [[1], 2, 3, 4], [10**400] * 4])
def test_what_is_no_action_is_none(flying: SteppedLayer, action: Any) -> None:
    assert flying.step(action=action).reason is Reason.NO_ACTION


def test_a_loop_that_hangs_is_named(flying: SteppedLayer) -> None:
    flying.cycle += 5
    status = flying.step()
    assert (status.state, status.reason) == (SafetyState.HOLDING, Reason.LATE_CYCLE)
    assert flying.step(now=START).reason is Reason.CLOCK


@pytest.mark.parametrize("now", [math.nan, None, START - 3600.0])
def test_a_clock_that_does_not_run_is_followed_by_silence(flying: SteppedLayer, now: Any) -> None:
    statuses = flying.steps(8, now=now)
    assert [status.setpoint for status in statuses] == [ZEROS] * 5 + [None] * 3
    assert names(statuses) == [("holding", "clock"), ("silent", "clock")]
    assert flying.step().reason is Reason.LATE_CYCLE
    assert flying.steps(13)[-1].state is SafetyState.FLYING


def test_after_a_short_fault_the_policy_flies_when_all_rules_have_held_for_a_while(flying: SteppedLayer) -> None:
    statuses = [*flying.steps(2, scan_age=0.3), *flying.steps(5)]
    assert names(statuses) == [("holding", "old_scan"), ("holding", "settling"), ("flying", "in_control")]
    assert [status.state is SafetyState.FLYING for status in statuses] == [False] * 5 + [True] * 2


def test_a_sensor_that_comes_and_goes_does_not_hold_the_vehicle_for_ever(flying: SteppedLayer) -> None:
    statuses = [flying.step(scan_age=0.3 if tick % 2 == 0 else 0.0) for tick in range(30)]
    assert [status.state for status in statuses[:7]] == [SafetyState.HOLDING] * 6 + [SafetyState.SILENT]
    assert {status.state for status in statuses[6:]} == {SafetyState.SILENT}


def test_after_silence_it_takes_a_second_and_a_cycle_of_zeros(flying: SteppedLayer) -> None:
    flying.steps(8, scan_age=None)
    statuses = flying.steps(12)
    assert [status.setpoint for status in statuses[:10]] == [None] * 10
    assert statuses[10].setpoint == ZEROS
    assert statuses[11].state is SafetyState.FLYING


def test_when_the_pilot_takes_over_zeros_are_streamed_from_the_next_cycle(flying: SteppedLayer) -> None:
    status = flying.step(in_control=False)
    assert (status.state, status.reason, status.setpoint) == (SafetyState.STANDBY, Reason.NOT_IN_CONTROL, ZEROS)
    assert flying.step().state is SafetyState.FLYING


def test_clip_and_slew(flying: SteppedLayer) -> None:
    flying.steps(3, action=ZEROS)
    status = flying.step(action=(9.0, -9.0, 0.0, 9.0))
    assert status.setpoint == pytest.approx((2.0, -2.0, 0.0, 2.0))
    assert status.limited == ("clip",)
    status = flying.step(action=(-2.0, -2.0, 0.0, 2.0))
    assert status.setpoint == pytest.approx((0.0, -2.0, 0.0, 2.0))
    assert status.limited == ("slew",)


@pytest.mark.parametrize(
    ("position", "yaw", "action", "reason", "setpoint"),
    [
        ((0.0, 0.0, 4.9), 0.0, (1.0, 0.0, 1.0, 0.5), "ceiling", (1.0, 0.0, 0.1, 0.5)),
        ((0.0, 0.0, 5.2), 0.0, (1.0, 0.0, 1.0, 0.5), "ceiling", (1.0, 0.0, 0.0, 0.5)),
        ((0.0, 0.0, 1.0), 0.0, (1.0, 0.0, -1.0, 0.0), "floor", (1.0, 0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.8), 0.0, (0.0, 0.0, 1.0, 0.0), "in_control", (0.0, 0.0, 1.0, 0.0)),  # back inside
        ((9.5, 0.0, 3.0), 0.0, (2.0, 1.0, 0.0, 0.0), "wall", (0.5, 1.0, 0.0, 0.0)),
        ((9.5, 0.0, 3.0), math.pi / 2, (1.0, -2.0, 0.0, 0.0), "wall", (1.0, -0.5, 0.0, 0.0)),  # east is to the right
        ((0.0, -4.0, 3.0), math.pi, (0.0, 2.0, 0.0, 0.0), "wall", (0.0, 1.0, 0.0, 0.0)),  # south is to the left
    ],
)
def test_the_fence_takes_what_leads_out(
    position: tuple[float, ...], yaw: float, action: tuple[float, ...], reason: str, setpoint: tuple[float, ...]
) -> None:
    flight = SteppedLayer(SafetyLimits(box=(-10.0, -5.0, 10.0, 5.0)))
    flight.steps(12)
    status = [flight.step(position=position, yaw=yaw, action=action) for _ in range(2)][-1]
    assert str(status.reason) == reason
    assert status.state is (SafetyState.FLYING if reason == "in_control" else SafetyState.FENCED)
    assert status.setpoint == pytest.approx(setpoint)


def test_a_record_can_be_written_as_json(flying: SteppedLayer) -> None:
    record = json.loads(json.dumps(flying.step().as_dict(), allow_nan=False))
    assert (record["state"], record["reason"], record["setpoint"]) == ("flying", "in_control", [0.5, -0.5, 0.25, 0.1])
    assert record["pose_age"] == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        ({"velocity": 0.0}, "velocity must be a finite number above 0, got 0.0"),
        ({"hold": math.nan}, "hold must be a finite number above 0"),
        ({"scan_age": "0.2"}, "scan_age must be a finite number above 0"),
        ({"scan_age": 200}, "scan_age must be at most 1 s, got 200 s: limits are in seconds."),
        ({"pose_age": 100}, "pose_age must be at most 1 s, got 100 s"),
        ({"hold": 500.0}, "hold must be at most 10 s, got 500 s"),
        ({"floor": 5.0}, "The fence has no inside: floor 5 must be below ceiling 5"),
        ({"ceiling": math.nan}, "The fence has no inside"),
        ({"box": (1.0, 0.0, 0.0, 1.0)}, "x_min below x_max"),
        ({"box": (1.0, 0.0)}, "box must be four numbers"),
    ],
)
def test_limits_that_make_no_sense_are_refused(limits: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UavrlError, match=sentence):
        SafetyLimits(**limits)


BOX = SafetyLimits(box=(-10.0, -5.0, 10.0, 5.0))
anything = st.one_of(st.floats(), st.none(), st.just("x"), st.integers())
numbers = st.floats(-4.0, 4.0)
actions = st.one_of(
    st.tuples(numbers, numbers, numbers, numbers), st.lists(anything, max_size=5), anything, st.just(np.eye(4))
)
positions = st.one_of(
    st.tuples(st.floats(-12.0, 12.0), st.floats(-7.0, 7.0), st.floats(0.0, 7.0)),
    st.lists(anything, max_size=4),
    anything,
)
ages = st.one_of(st.floats(0.0, 0.3), st.just(0.0), anything)
cycles = st.lists(
    st.tuples(
        st.one_of(st.just(0.1), st.just(0.1), st.floats(-0.5, 2.0), st.just(math.nan)),
        actions,
        ages,
        ages,
        positions,
        st.one_of(st.floats(-10.0, 10.0), anything),
        st.booleans(),
    ),
    max_size=15,
)
sane = st.just([(0.1, (1.0, 1.0, 0.0, 0.0), 0.0, 0.0, (0.0, 0.0, 3.0), 0.0, True)] * 13)


def stamp(now: float, age: Any) -> Any:
    return now - age if isinstance(age, float) else age


@settings(max_examples=60, deadline=None)
@given(runs=st.lists(st.one_of(cycles, sane), max_size=4))
def test_whatever_comes_in_what_goes_out_is_finite_and_within_limits(runs: list[list[tuple[Any, ...]]]) -> None:
    layer, now, zeros_since, before = SafetyLayer(BOX), START, None, None
    latest, clockless = START, 0
    most = np.array([2.0, 2.0, 2.0, 2.0])
    for passed, action, scan_age, pose_age, position, yaw, in_control in [cycle for run in runs for cycle in run]:
        now = latest + passed
        at = Cycle(now, action, stamp(now, scan_age), stamp(now, pose_age), position, yaw, in_control)
        status = layer.step(at)
        elapsed = max(now - latest, 0.0) if math.isfinite(now) else 0.0
        latest = max(latest, now) if math.isfinite(now) else latest
        clockless = clockless + 1 if status.reason is Reason.CLOCK else 0
        assert math.isfinite(status.time)
        assert status.sentence
        assert isinstance(status.reason, Reason)
        if status.setpoint is None:
            assert status.state is SafetyState.SILENT
            if before is not None and before.setpoint is not None:  # silence begins
                assert zeros_since is not None
                assert status.time - zeros_since + 0.1 * max(clockless - 1, 0) >= 0.5 - 1e-5
        else:
            assert np.isfinite(status.setpoint).all()
            assert (np.abs(status.setpoint) <= most).all()
        if status.state in (SafetyState.FLYING, SafetyState.FENCED):
            assert in_control
            assert before is not None
            assert before.state is not SafetyState.SILENT
            change = np.abs(np.array(status.setpoint) - np.array(before.setpoint))
            assert status.state is SafetyState.FENCED or (change <= 20.0 * elapsed + 1e-9).all()
        elif status.setpoint is not None:
            assert status.setpoint == ZEROS
        if status.setpoint != ZEROS:
            zeros_since = None
        elif zeros_since is None:
            zeros_since = status.time
        before = status


@settings(deadline=None)
@given(
    action=st.tuples(*[st.floats(-5.0, 5.0)] * 4),
    previous=st.tuples(*[st.floats(-2.0, 2.0)] * 4),
    position=st.tuples(st.floats(-10.5, 10.5), st.floats(-5.5, 5.5), st.floats(0.5, 5.5)),
    yaw=st.floats(-7.0, 7.0),
)
def test_no_velocity_leads_out_of_the_fence_faster_than_in_its_time(
    action: tuple[float, ...], previous: tuple[float, ...], position: tuple[float, ...], yaw: float
) -> None:
    place = np.array(position)
    forward, left, up, yaw_rate = limit(np.array(action), np.array(previous), 0.1, place, yaw, BOX).setpoint
    cos, sin = math.cos(yaw), math.sin(yaw)
    velocity = np.array([cos * forward - sin * left, sin * forward + cos * left, up])
    low, high = BOX.corners
    assert (velocity <= np.maximum(high - place, 0.0) + 1e-9).all()
    assert (velocity >= -np.maximum(place - low, 0.0) - 1e-9).all()
    assert abs(yaw_rate) <= 2.0
