"""The keys of ``uavrl-fly`` that say what a vehicle and its LiDAR are like."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from uavrl_onboard.cli.fly import FlyConfig, make_guards, make_vehicle
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.limits import SafetyLimits
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.vehicle import Vehicle


def policy(motion: object = None, guards: GuardSettings | None = None, vehicle: Vehicle | None = None) -> Any:
    settings, flown = GuardSettings() if guards is None else guards, Vehicle() if vehicle is None else vehicle
    return SimpleNamespace(contract=SimpleNamespace(motion=motion, guard_settings=settings, vehicle=flown))


def config(**keys: Any) -> FlyConfig:
    return FlyConfig(policy="policy", goal=(20.0, 0.0, 2.5), **keys)


@pytest.mark.parametrize("mount", [(180.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, 4.0, 0.0), (180.0, 0.0, -120.0)])
def test_a_level_lidar_is_flown_with_all_guards(mount: tuple[float, ...]) -> None:
    assert make_guards(config(mount=mount), policy(guards=GuardSettings.all())).settings == GuardSettings.all()


def test_evasion_is_refused_for_a_tilted_lidar_wherever_it_was_asked_for() -> None:
    for keys, contract in (({"guards": "all"}, None), ({}, GuardSettings.all())):
        with pytest.raises(UavrlError, match=r"tilts the LiDAR by 20 degrees.*\(guards=\[map,shield\]\)\."):
            make_guards(config(mount=(180.0, 20.0, 0.0), **keys), policy(guards=contract))
    with pytest.raises(UavrlError, match=r"leave evasion out \(guards=none\)\."):
        make_guards(config(mount=(0.0, 20.0, 0.0), guards=["evasion"]), policy())
    assert make_guards(config(mount=(0.0, 20.0, 0.0), guards=["map", "shield"]), policy()).settings.evasion is None


def test_a_policy_that_looks_for_moving_objects_is_refused_for_a_tilted_lidar() -> None:
    with pytest.raises(UavrlError, match="this policy looks for moving objects, so mount the LiDAR level"):
        make_guards(config(mount=(0.0, 20.0, 0.0), guards="none"), policy(motion=object()))


def test_guards_keep_the_policys_limits_and_those_of_the_safety_layer() -> None:
    slow, fast = Vehicle(velocity_limit=0.5, yaw_rate_limit=0.5), Vehicle(velocity_limit=6.0)
    for trained, expected in ((slow, (0.5, 0.5)), (Vehicle(), (2.0, 2.0)), (fast, (2.0, 2.0))):
        made = make_vehicle(config(), policy(vehicle=trained))
        assert (made.velocity_limit, made.yaw_rate_limit) == expected
    raised = config(safety=SafetyLimits(velocity=8.0))
    assert make_vehicle(raised, policy(vehicle=fast)).velocity_limit == 6.0
