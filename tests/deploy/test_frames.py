"""From MAVLink's frames to ours: signs that a wrong one of would fly a vehicle into a wall."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uavrl.deploy.frames import Pose, swap_world, swap_yaw, to_command, to_goal
from uavrl.envs.simulation import Simulation
from uavrl.errors import UavrlError

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


def test_the_simulator_flies_a_command_as_an_autopilot_does() -> None:
    """An autopilot turns a command with its yaw; what comes out in its axes is what the simulator does in ours."""
    simulation = Simulation([], 1)
    try:
        compass, action = math.radians(30.0), np.array([1.0, 0.5, 0.25, 0.8])
        simulation.reset(np.array([0]), np.array([[0.0, 0.0, 50.0]]), np.array([swap_yaw(compass)]))
        start = simulation.position[0].copy()
        straight = np.array([*action[:3], 0.0])
        for _ in range(30):
            simulation.step(straight[None])
        flown = simulation.position[0] - start
        vx, vy, vz, _ = to_command(action)
        north, east = (
            math.cos(compass) * vx - math.sin(compass) * vy,
            math.sin(compass) * vx + math.cos(compass) * vy,
        )
        wanted = np.array(swap_world((north, east, vz)))
        np.testing.assert_allclose(flown / np.linalg.norm(flown), wanted / np.linalg.norm(wanted), atol=0.05)
        before = simulation.yaw[0]
        simulation.step(action[None])
        simulation.step(action[None])
        turned = math.remainder(swap_yaw(simulation.yaw[0]) - swap_yaw(before), math.tau)
        assert turned * to_command(action).yaw_rate > 0.0
    finally:
        simulation.close()
