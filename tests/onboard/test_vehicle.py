"""One record says what a vehicle is, and everything takes it from there."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest

from uavrl.envs.quadrotor import Airframe
from uavrl.envs.simulation import CONTROL_RATE
from uavrl.envs.world import WorldConfig
from uavrl.evaluation.policies import PACKAGED
from uavrl.planners.vfh_star import VFHStar
from uavrl.transforms.state import ACTION_LIMIT
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.limits import SafetyLimits
from uavrl_onboard.policy.contract import read_contract
from uavrl_onboard.vehicle import VEHICLE, Vehicle


def test_the_default_vehicle_is_the_simulated_one() -> None:
    assert dataclasses.astuple(VEHICLE) == (
        0.35,
        0.28,
        (0.0, 0.0, 0.1),
        2.0,
        2.0,
        10.0,
        3.5,
        -2.3,
        0.7,
        (-15.0, 15.0),
        True,
    )
    assert Airframe().vehicle() == VEHICLE
    assert (CONTROL_RATE, VEHICLE.period, ACTION_LIMIT) == (10, 0.1, 2.0)
    assert (WorldConfig().flight_level, WorldConfig().uav_radius) == (VEHICLE.flight_level, VEHICLE.radius)
    assert (SafetyLimits().velocity, SafetyLimits().yaw_rate) == (VEHICLE.velocity_limit, VEHICLE.yaw_rate_limit)


def test_a_planner_assumes_the_airframe_and_the_flight_level_of_its_world() -> None:
    airframe = Airframe(collision_radius=0.4, collision_height=0.3, lidar_position=(0.0, 0.0, 0.13))
    expected = Vehicle(radius=0.4, height=0.3, lidar_position=(0.0, 0.0, 0.13), flight_level=3.0)
    assert VFHStar(3.0, airframe=airframe).vehicle == expected


def test_a_contract_says_what_its_vehicle_is(tmp_path: Path) -> None:
    told = json.loads((PACKAGED / "best" / "contract.json").read_text())
    told.pop("sha256")  # a contract without a checksum may be edited
    assert read_contract(PACKAGED / "best").vehicle == VEHICLE
    told["cloud"]["sensor_position"] = [0.05, 0.0, 0.2]
    told["action"]["high"] = [1.5, 1.5, 1.0, 1.2]
    (tmp_path / "contract.json").write_text(json.dumps(told))
    other = read_contract(tmp_path).vehicle
    assert (other.lidar_position, other.velocity_limit, other.yaw_rate_limit) == ((0.05, 0.0, 0.2), 1.5, 1.2)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"radius": 0.0}, "vehicle's radius must be a finite number above 0, got 0.0"),
        ({"height": math.nan}, "vehicle's height must be a finite number above 0, got nan"),
        ({"velocity_limit": "fast"}, "vehicle's velocity_limit must be a finite number above 0, got 'fast'"),
        ({"highest": math.inf}, "vehicle's highest must be a finite number, got inf"),
        ({"lowest": 0.5}, "lowest and highest are offsets from its flight level"),
        ({"lidar_position": (0.0, 0.1)}, "three finite numbers in m: forward, left, up; got"),
        ({"lidar_position": "top"}, "three finite numbers in m: forward, left, up; got 'top'"),
    ],
)
def test_a_vehicle_that_nothing_can_be_computed_with_is_refused(wrong: dict[str, Any], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        Vehicle(**wrong)
