"""The keys of ``uavrl-fly`` that say what a vehicle and its LiDAR are like."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from uavrl_onboard.cli.fly import FlyConfig, make_guards
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.vehicle import Vehicle


def policy(motion: object = None, guards: GuardSettings | None = None) -> Any:
    settings = GuardSettings() if guards is None else guards
    return SimpleNamespace(contract=SimpleNamespace(motion=motion, guard_settings=settings, vehicle=Vehicle()))


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
