"""From MAVLink's frames to ours: signs that a wrong one of would fly a vehicle into a wall."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.rotmat import Matrix3, Vector3
from scipy.spatial.transform import Rotation

from uavrl_onboard.autopilot.frames import (
    Pose,
    swap_attitude,
    swap_world,
    swap_yaw,
    to_command,
    to_goal,
)
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import roll_pitch_yaw

QUARTER = math.pi / 2


def test_north_east_down_is_east_north_up_and_back() -> None:
    assert swap_world((10.0, 20.0, -3.5)) == (20.0, 10.0, 3.5)
    assert swap_world(swap_world((1.0, -2.0, 3.0))) == (1.0, -2.0, 3.0)


@pytest.mark.parametrize(
    ("compass", "yaw"),
    [(0.0, QUARTER), (QUARTER, 0.0), (math.pi, -QUARTER), (-QUARTER, math.pi), (QUARTER / 2, QUARTER / 2)],
)
def test_a_yaw_from_north_to_the_right_is_one_from_east_to_the_left(compass: float, yaw: float) -> None:
    assert abs(swap_yaw(compass)) == pytest.approx(abs(yaw))
    assert math.cos(swap_yaw(compass)) == pytest.approx(math.cos(yaw))
    assert math.sin(swap_yaw(compass)) == pytest.approx(math.sin(yaw))
    assert math.remainder(swap_yaw(swap_yaw(compass)) - compass, math.tau) == pytest.approx(0.0)


def test_a_yaw_that_is_none_stays_none() -> None:
    assert math.isnan(swap_yaw(math.nan))
    assert math.isnan(swap_yaw(math.inf))


def axes(pose: Pose) -> np.ndarray:
    """Where forward, left and up of a vehicle point in the world."""
    w, *axis = pose.rotation
    return Rotation.from_quat([*axis, w]).as_matrix().T


def at(yaw: float, roll: float = 0.0, pitch: float = 0.0) -> Pose:
    return Pose(0.0, (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), yaw, roll, pitch)


@pytest.mark.parametrize(
    ("told", "forward", "left"),
    [  # roll to the right, pitch nose up, yaw from north to the right; east, north, up
        ((0.0, math.pi / 6, 0.0), (0.0, math.sqrt(0.75), 0.5), (-1.0, 0.0, 0.0)),  # heads north, nose up
        ((math.pi / 6, 0.0, 0.0), (0.0, 1.0, 0.0), (-math.sqrt(0.75), 0.0, 0.5)),  # heads north, right side down
        ((0.0, -math.pi / 6, QUARTER), (math.sqrt(0.75), 0.0, -0.5), (0.0, 1.0, 0.0)),  # heads east, nose down
        ((-math.pi / 6, 0.0, QUARTER), (1.0, 0.0, 0.0), (0.0, math.sqrt(0.75), -0.5)),  # heads east, left side down
    ],
)
def test_roll_and_pitch_as_mavlink_tells_them(
    told: tuple[float, float, float], forward: tuple[float, ...], left: tuple[float, ...]
) -> None:
    roll, pitch, yaw = swap_attitude(*told)
    np.testing.assert_allclose(axes(at(yaw, roll, pitch))[:2], [forward, left], atol=1e-12)
    np.testing.assert_allclose(swap_attitude(roll, pitch, yaw), told, atol=1e-12)


def test_any_attitude_is_the_one_that_pymavlink_computes() -> None:
    for told in np.random.default_rng(0).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (50, 3)):
        judge = Matrix3()
        judge.from_euler(*told)  # from forward, right, down to north, east, down
        wanted = [judge * Vector3(*axis) for axis in ((1, 0, 0), (0, -1, 0), (0, 0, -1))]  # forward, left, up
        roll, pitch, yaw = swap_attitude(*told)
        np.testing.assert_allclose(
            axes(at(yaw, roll, pitch)), [swap_world((each.x, each.y, each.z)) for each in wanted], atol=1e-9
        )


def test_a_rotation_by_its_angles_is_the_same_also_straight_down() -> None:
    any_way = Rotation.random(50, rng=np.random.default_rng(0))
    down, over = Rotation.from_euler("ZYX", [0.7, QUARTER, 0.4]), Rotation.from_euler("ZYX", [3.0, -QUARTER, -2.0])
    for turn in (*any_way, down, over, Rotation.from_euler("x", math.pi), Rotation.identity()):
        x, y, z, w = turn.as_quat()
        for sign in (1.0, -1.0):  # both are the same rotation
            roll, pitch, yaw = roll_pitch_yaw((sign * w, sign * x, sign * y, sign * z))
            assert abs(roll) <= math.pi and abs(pitch) <= QUARTER and abs(yaw) <= math.pi
            np.testing.assert_allclose(axes(at(yaw, roll, pitch)), turn.as_matrix().T, atol=1e-9)
    assert roll_pitch_yaw(Rotation.from_euler("ZYX", [1.0, 0.5, -0.25]).as_quat()[[3, 0, 1, 2]]) == pytest.approx(
        (-0.25, 0.5, 1.0)
    )


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_an_angle_that_is_none_leaves_what_is_known(wrong: float) -> None:
    level = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]  # heads north
    np.testing.assert_allclose(axes(at(QUARTER, roll=wrong, pitch=0.5)), level, atol=1e-12)
    np.testing.assert_allclose(axes(at(QUARTER, roll=0.5, pitch=wrong)), level, atol=1e-12)
    assert np.isnan(at(wrong, 0.5, 0.5).rotation).all()
    assert np.isnan(roll_pitch_yaw((wrong, 0.0, 0.0, 0.0))).all()


@pytest.mark.parametrize(
    ("action", "command"),
    [
        ((2.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)),  # forward
        ((0.0, 2.0, 0.0, 0.0), (0.0, -2.0, 0.0, 0.0)),  # left
        ((0.0, 0.0, 2.0, 0.0), (0.0, 0.0, -2.0, 0.0)),  # up
        ((0.0, 0.0, 0.0, 2.0), (0.0, 0.0, 0.0, -2.0)),  # turning left
    ],
)
def test_an_action_as_mavlink_has_it(action: tuple[float, ...], command: tuple[float, ...]) -> None:
    assert to_command(action) == command
    assert to_command(to_command(action)) == action
    assert "-0" not in str(to_command((0.0, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize("wrong", [(1.0, 2.0), (1.0, 2.0, math.nan, 0.0), (0.0, 0.0, 0.0, 1e39), np.zeros((1, 4))])
def test_what_is_no_setpoint_is_refused(wrong: object) -> None:
    with pytest.raises(UavrlError, match="four finite numbers"):
        to_command(wrong)  # type: ignore[arg-type]


def heading_north(goal: tuple[float, float, float]) -> dict[str, float]:
    """What a policy reads on a vehicle 3 m above the origin that faces north."""
    return to_goal(Pose(0.0, swap_world((0.0, 0.0, -3.0)), (0.0, 0.0, 0.0), swap_yaw(0.0)), goal)


def test_the_goal_ahead_to_the_left_and_below() -> None:
    assert heading_north((0.0, 5.0, 3.0))["heading_deg"] == pytest.approx(0.0, abs=1e-5)  # north
    assert heading_north((-5.0, 0.0, 3.0))["heading_deg"] == pytest.approx(90.0)  # west
    assert heading_north((5.0, 0.0, 3.0))["heading_deg"] == pytest.approx(270.0)  # east
    below = heading_north((0.0, 3.0, 0.0))
    assert below["elevation_deg"] == pytest.approx(315.0)
    assert below["altitude"] == 3.0
    assert below["distance"] == pytest.approx(math.hypot(3.0, 3.0))
