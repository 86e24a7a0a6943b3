"""Poses that are fresh and finite, and that no vehicle can have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from onboard.tests.flight.test_loop import Rig

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.plausible import Implausible, PoseCheck
from uavrl_onboard.flight.safety import Reason, SafetyState
from uavrl_onboard.flight.summary import FlightSummary
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.map import Wayfinder
from uavrl_onboard.guards.settings import guard_settings

STILL = (0.0, 0.0, 0.0)


def looked(poses: list[Pose]) -> list[Implausible | None]:
    check = PoseCheck()
    return [check.look(pose) for pose in poses]


def flight(seconds: float, pose: Callable[[float], Pose], rate: float = 10.0) -> list[Pose]:
    return [pose(number / rate) for number in range(int(seconds * rate))]


def circling(time: float, speed: float = 2.0) -> Pose:
    """A vehicle on a circle of 4 m, its nose ahead."""
    turned = speed * time / 4.0
    place = (4.0 * math.sin(turned), 4.0 - 4.0 * math.cos(turned), 3.0)
    return Pose(time, place, (speed * math.cos(turned), speed * math.sin(turned), 0.0), turned)


@pytest.mark.parametrize("rate", [9.0, 10.0, 50.0])
@pytest.mark.parametrize("speed", [0.0, 2.0, 12.0])
def test_what_flies_is_believed(speed: float, rate: float) -> None:
    assert not any(looked(flight(5.0, lambda time: circling(time, speed), rate)))


def test_what_is_noisy_or_drifts_is_believed() -> None:
    rng = np.random.default_rng(0)
    poses = flight(20.0, circling)
    noisy = [
        replace(each, position=tuple(each.position + rng.normal(0, 0.1, 3) + [0.3 * each.stamp, 0.0, 0.0]))
        for each in poses
    ]
    assert not any(looked(noisy))


def test_a_jump_is_told_with_its_distance_and_time_once() -> None:
    poses = flight(2.0, lambda time: Pose(time, (20.0 if time >= 1.0 else 0.0, 0.0, 3.0), STILL, 0.0))
    found = looked(poses)
    jump = Implausible(
        Reason.POSITION_JUMPED,
        "the position jumped by 20.0 m in 0.10 s, and the vehicle flies at most 0.7 m in that time",
        True,
    )
    assert found == [None] * 10 + [jump] + [None] * 9


@pytest.mark.parametrize("far", [2e5, -3e38, 1e300])
def test_a_position_that_is_nowhere_is_never_believed(far: float) -> None:
    """An estimator that has diverged: the jump is over after a cycle, and the position stays."""
    rig = Rig()
    rig.airborne()
    cycles = moved(rig, (far, 0.0, 3.5), 40)
    assert {cycle.status.reason for cycle in cycles} == {Reason.POSITION_FAR}
    assert cycles[-1].status.state is SafetyState.SILENT
    told = f"the position is {abs(far):.2g} m from the autopilot's origin, and no vehicle flies so far: look at its"
    assert cycles[0].status.sentence.startswith(told)


def test_a_jump_across_a_gap_has_the_time_of_the_gap() -> None:
    before, after = circling(1.0), replace(circling(1.0), stamp=3.0)
    assert looked([before, replace(after, position=(before.position[0] + 8.0, *before.position[1:]))]) == [None, None]
    far = looked([before, replace(after, position=(before.position[0] + 9.0, *before.position[1:]))])[1]
    assert far is not None and far.sentence.startswith("the position jumped by 9.0 m in 2.00 s, and the vehicle flies")


def test_a_velocity_that_jumps_along_excuses_no_jump() -> None:
    found = looked([circling(1.0), Pose(1.1, (20.0, 0.0, 3.0), (180.0, 0.0, 0.0), 0.5)])[1]
    assert found is not None and found.reason is Reason.POSITION_JUMPED and "at most 2.7 m" in found.sentence


@pytest.mark.parametrize("yaw", [1.6, -1.6, 3.1])
def test_a_yaw_that_jumps_is_told(yaw: float) -> None:
    found = looked([Pose(1.0, STILL, STILL, 3.0), Pose(1.1, STILL, STILL, 3.0 + yaw)])[1]
    assert found is not None and found.reason is Reason.YAW_JUMPED and found.starts_anew
    assert found.sentence == (
        f"the yaw jumped by {math.degrees(abs(yaw)):.0f}° in 0.10 s, and the vehicle turns by at most 52° in that time"
    )


def test_a_reset_that_the_autopilot_tells_of_is_believed() -> None:
    found = looked([Pose(1.0, STILL, STILL, 0.0), Pose(1.1, (0.3, 0.0, 0.0), STILL, 0.0, resets=1)])[1]
    assert found == (
        Reason.POSE_RESET,
        "the autopilot's estimator was reset: the pose moved by 0.3 m and 0° in 0.10 s",
        True,
    )
    jumped = looked([Pose(1.0, STILL, STILL, 0.0), Pose(1.1, (3.0, 0.0, 0.0), STILL, 0.0, resets=1)])[1]
    assert jumped is not None and "in 0.10 s, as the autopilot's estimator was reset, and" in jumped.sentence


@pytest.mark.parametrize(
    ("told", "says"),
    [
        (lambda v: (0.0, 0.0, 0.0), "2.0 m/s, and the velocity says 0.0 m/s"),
        (lambda v: (v[1], -v[0], v[2]), "2.0 m/s, and the velocity says 2.0 m/s, or another way"),
    ],
    ids=["never filled in", "in other axes"],
)
def test_a_velocity_that_is_not_that_of_the_position(told: Callable[[tuple[float, ...]], tuple], says: str) -> None:
    ahead = flight(3.0, lambda time: Pose(time, (2.0 * time, 0.0, 3.0), told((2.0, 0.0, 0.0)), 0.0))
    found = looked(ahead)
    assert not any(found[:10]) and all(found[11:])
    assert found[15] is not None and found[15].reason is Reason.VELOCITY_DISAGREES and says in found[15].sentence
    stands = [Pose(3.0 + 0.1 * number, (5.9, 0.0, 3.0), STILL, 0.0) for number in range(80)]
    after = looked([*ahead, *stands])[len(ahead) :]
    assert all(after[:45]) and not any(after[65:])


def test_poses_that_are_none_or_old_are_not_compared() -> None:
    nan = Pose(1.1, (math.nan, 0.0, 0.0), STILL, 0.0)
    again, older = Pose(1.0, (9.0, 0.0, 0.0), STILL, 0.0), Pose(0.5, (9.0, 0.0, 0.0), STILL, 0.0)
    check = PoseCheck()
    assert [check.look(each) for each in (Pose(1.0, STILL, STILL, 0.0), nan, None, again, older)] == [None] * 5
    assert check.look(Pose(1.2, (9.0, 0.0, 0.0), STILL, 0.0)) is not None


def moved(rig: Rig, place: tuple[float, float, float], cycles: int) -> list[FlightCycle]:
    rig.link.place = place
    return [rig.scan() for _ in range(cycles)]


def test_a_jump_to_the_goal_holds_and_does_not_arrive_at_once() -> None:
    rig, summary = Rig(), FlightSummary()
    rig.airborne()
    resets = rig.policy.resets
    jumped, *after = moved(rig, (20.0, 0.0, 3.0), 8)
    assert (jumped.status.state, jumped.status.reason) == (SafetyState.HOLDING, Reason.POSITION_JUMPED)
    assert jumped.status.sentence.startswith("the position jumped by 20.0 m in 0.10 s, and")
    assert jumped.status.setpoint == (0.0, 0.0, 0.0, 0.0) and jumped.status.changed
    assert rig.policy.resets > resets, "the policy starts anew"
    assert [cycle.arrived for cycle in (jumped, *after[:4])] == [False] * 5
    for cycle in (jumped, *after):
        summary.add(cycle)
    assert rig.flight.arrived is not None, "what is the pose for long is believed in the end"
    back, *_ = moved(rig, (0.0, 0.0, 3.0), 1)
    summary.add(back)
    assert not back.arrived and rig.flight.arrived is None and not summary.facts()["arrived"]
    assert back.status.reason is Reason.POSITION_JUMPED


def test_a_pose_that_jumps_again_and_again_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig()
    rig.airborne()
    states = {moved(rig, (20.0 * (number % 2), 0.0, 3.5), 1)[0].status.state for number in range(1, 30)}
    assert states == {SafetyState.HOLDING, SafetyState.SILENT}
    assert len([told for told in caplog.messages if told.startswith("Pose: the position jumped")]) == 1
    moved(rig, (0.0, 0.0, 3.5), 20)
    moved(rig, (20.0, 0.0, 3.5), 1)
    assert len([told for told in caplog.messages if told.startswith("Pose: the position jumped")]) == 2


def test_after_a_jump_the_map_is_empty_and_without_one_it_is_not() -> None:
    wall = np.stack(np.broadcast_arrays(2.0, np.linspace(-1.0, 3.0, 40), -0.1), -1)
    for far, kept in ((0.2, True), (5.0, False)):
        guards = Guards(guard_settings("map"))
        led, rig = guards.guards["map"], Rig(guards=guards)
        assert isinstance(led, Wayfinder)
        rig.airborne()
        rig.scan(wall)
        (navigator,) = led.navigators
        before = navigator.known
        rig.link.place = (far, 0.0, 3.5)
        rig.scan(np.full((1, 3), np.nan))
        assert (navigator.known is before) is kept


@pytest.mark.parametrize("yaw", [0.0, 1.6])
def test_a_yaw_that_jumps_holds_the_flight(yaw: float) -> None:
    rig = Rig()
    rig.airborne()
    rig.link.pose = lambda: Pose(rig.now, (0.0, 0.0, 3.5), STILL, yaw)  # type: ignore[method-assign]
    assert rig.scan().status.state is (SafetyState.HOLDING if yaw else SafetyState.FLYING)
    assert [rig.scan().status.state for _ in range(4)][-1] is SafetyState.FLYING
