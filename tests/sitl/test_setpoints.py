"""How an autopilot reads a set-point: frames, signs, and what its mask leaves open."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from uavrl.errors import UavrlError
from uavrl.sitl.setpoints import BODY_NED, LOCAL_NED, read_setpoint
from uavrl_onboard.autopilot.frames import to_command
from uavrl_onboard.autopilot.mavlink import TYPE_MASK

NOTHING = (0.0, 0.0, 0.0)
EAST, NORTH = 0.0, math.pi / 2


def message(
    frame: int = LOCAL_NED,
    mask: int = 0,
    position: tuple[float, ...] = NOTHING,
    velocity: tuple[float, ...] = NOTHING,
    yaw: float = 0.0,
    yaw_rate: float = 0.0,
) -> Any:
    numbers = (*position, *velocity, *NOTHING, yaw, yaw_rate)
    return common.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *numbers)


def test_what_our_side_sends_comes_back_as_it_was() -> None:
    sent = (1.5, 0.5, -0.25, 1.25)
    forward, right, down, turn = to_command(sent)
    read = read_setpoint(message(BODY_NED, TYPE_MASK, velocity=(forward, right, down), yaw_rate=turn), yaw=0.7)
    assert read.command(np.zeros(3), 0.7).tolist() == list(sent)


@pytest.mark.parametrize(("yaw", "velocity"), [(EAST, [1.0, 0.5, 0.25]), (NORTH, [-0.5, 1.0, 0.25])])
def test_velocities_of_the_body_turn_with_the_yaw_of_their_arrival(yaw: float, velocity: list[float]) -> None:
    read = read_setpoint(message(BODY_NED, TYPE_MASK, velocity=(1.0, -0.5, -0.25)), yaw)
    for later in (yaw, yaw + 0.5):
        demand, turn = read.demand(np.zeros(3), later)
        np.testing.assert_allclose(demand, velocity, atol=1e-6)
        assert turn == 0.0


def test_velocities_of_the_world() -> None:
    read = read_setpoint(message(mask=TYPE_MASK, velocity=(1.0, 0.5, -0.25), yaw_rate=0.5), yaw=2.0)
    demand, turn = read.demand(np.zeros(3), 2.0)
    assert demand.tolist() == [0.5, 1.0, 0.25] and turn == -0.5
    np.testing.assert_allclose(read.command(np.zeros(3), NORTH), [1.0, -0.5, 0.25, -0.5], atol=1e-9)


def test_a_velocity_with_a_yaw_to_face_turns_there_the_short_way() -> None:
    only_yaw_rate_ignored = 1 | 2 | 4 | 64 | 128 | 256 | 2048
    read = read_setpoint(message(mask=only_yaw_rate_ignored, velocity=(1.0, 0.0, 0.0), yaw=math.pi / 2), yaw=0.0)
    assert read.demand(np.zeros(3), 0.1)[1] == pytest.approx(-0.28)  # east is ahead, 0.1 rad to the right
    assert read.demand(np.zeros(3), -0.1 + 2 * math.pi)[1] == pytest.approx(0.28)
    assert read.demand(np.zeros(3), 3.0)[1] == -2.0


def test_a_position_is_flown_to_no_faster_than_the_vehicle_flies() -> None:
    only_position = 8 | 16 | 32 | 64 | 128 | 256 | 1024 | 2048
    read = read_setpoint(message(mask=only_position, position=(10.0, 2.0, -3.5)), yaw=0.0)
    demand, turn = read.demand(np.array([2.0, 9.0, 3.0]), 0.0)
    np.testing.assert_allclose(demand, [0.0, 0.95, 0.5], atol=1e-6)
    assert turn == 0.0 and read.demand(np.zeros(3), 0.0)[0].tolist() == [1.9, 2.0, 2.0]


def test_ignored_axes_are_left_alone() -> None:
    no_east = TYPE_MASK | 16
    assert read_setpoint(message(mask=no_east, velocity=(1.0, 1.0, -1.0)), 0.0).demand(np.zeros(3), 0.0)[
        0
    ].tolist() == [
        0.0,
        1.0,
        1.0,
    ]


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (message(frame=7, mask=TYPE_MASK), "got frame 7"),
        (message(mask=TYPE_MASK | 56), "does not ignore"),  # no velocity either
        (message(BODY_NED, 8 | 16 | 32, position=(1.0, 0.0, 0.0)), "does not ignore"),  # a position in the body's axes
        (message(BODY_NED, TYPE_MASK | 8, velocity=(1.0, 1.0, 1.0)), "does not ignore"),  # PX4 takes all three or none
        (message(mask=TYPE_MASK, velocity=(math.inf, 0.0, 0.0)), "finite"),
        (message(mask=TYPE_MASK, yaw_rate=-math.inf), "finite"),
        (message(BODY_NED, TYPE_MASK, velocity=(math.nan,) * 3), "does not ignore"),
        (message(BODY_NED, TYPE_MASK, velocity=(math.nan, 0.0, 0.0)), "finite"),
    ],
)
def test_what_is_not_obeyed(wrong: Any, says: str) -> None:
    with pytest.raises(UavrlError, match=says):
        read_setpoint(wrong, 0.0)
