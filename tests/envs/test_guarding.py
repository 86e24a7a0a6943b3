"""Guards know the vehicle and the LiDAR of their environment."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs import TransformedEnv

from uavrl.envs import NavigationEnv
from uavrl.envs.guarding import guarded
from uavrl.envs.gym import ValleyEnv
from uavrl.errors import UavrlError
from uavrl.transforms import NavigationState
from uavrl_onboard.guards.settings import guard_settings

SMALL = {"size": (14, 12), "obstacles": 3, "min_goal_distance": 4}


def env(**lidar: object) -> NavigationEnv:
    return NavigationEnv(1, world=SMALL, lidar={"max_range": 4.0, **lidar})


def test_they_know_what_the_lidar_sees() -> None:
    base = env(sensor="mid360", far_range=12.0)
    around = guarded(base, guard_settings("all"))
    assert around.vehicle.lidar_elevations == pytest.approx((-7.0, 52.0))
    assert around.guards.shield is not None and around.guards.shield.nearest == 0.1
    base = env(far_range=12.0, min_range=0.9)
    assert guarded(base, guard_settings("shield")).guards.shield.nearest == 0.9  # type: ignore[union-attr]
    own = guard_settings([{"shield": {"nearest": 0.4}}, "shield"])
    assert guarded(base, own).guards.shield.nearest == 0.4  # type: ignore[union-attr]


@pytest.mark.parametrize(("reach", "told"), [(4.0, "4"), (10.129, "10.12")])
def test_a_lidar_that_does_not_reach_is_refused(reach: float, told: str) -> None:
    found = r"guards\.map\.sight=12 and guards\.evasion\.sight=12 look farther than the LiDAR, which reaches [\d.]+ m: "
    with pytest.raises(UavrlError, match=found + rf"write guards\.map\.sight={told} guards\.evasion\.sight={told}, ra"):
        guarded(env(max_range=reach), guard_settings("all"))
    near = {name: {"sight": float(told)} for name in ("map", "evasion")}
    guarded(env(max_range=reach), guard_settings(["all", near]))


def test_a_camera_that_looks_ahead_is_told_to_fly_without_evasion(caplog: pytest.LogCaptureFixture) -> None:
    camera, near = env(sensor="d435", far_range=10.0), {"map": {"sight": 10.0}}
    guarded(camera, guard_settings(["map", "shield", near]))
    assert not caplog.messages
    guarded(camera, guard_settings(["all", near, {"evasion": {"sight": 10.0}}]))
    with pytest.raises(UavrlError, match=r"reaches 10 m: write guards=\[map,shield\] guards\.map\.sight=10, raise"):
        guarded(camera, guard_settings("all"))
    for told, end in zip(caplog.messages, ("]).", "] guards.map.sight=10)."), strict=True):
        assert told.startswith(
            "The LiDAR d435 does not see the same elevations on all sides, so static obstacles seem to move"
        )
        assert told.endswith("leave evasion out (guards=[map,shield" + end)


def test_a_lidar_of_one_layer_flies_with_all_guards() -> None:
    base = env(sensor="rplidar", far_range=12.0)
    flown = TransformedEnv(base, guarded(base, guard_settings("all"))).rollout(3)
    assert flown["action"].isfinite().all()


def test_gymnasium_s_environment_lets_its_lidar_reach_as_far_as_cells_and_guards() -> None:
    valley = ValleyEnv(world=SMALL, lidar={"sensor": "mid360"}, guards="all")
    config = valley._flights.base.lidar_config
    assert (config.max_range, config.far_range, config.device.name) == (4.0, 12.0, "mid360")
    valley.close()
    fast = ValleyEnv(world=SMALL, max_speed=6.0)
    assert fast._flights.base.lidar_config.max_range == 6.0
    fast.close()


def test_the_last_yaw_rate_is_what_the_vehicle_takes_at_any_speed() -> None:
    base = NavigationEnv(1, world=SMALL, lidar={"max_range": 4.0}, max_speed=4.0)
    valley = TransformedEnv(base, NavigationState(last_action=True, max_speed=4.0))
    state = valley.reset().set("action", torch.tensor([[1.0, 0.0, 0.0, 4.0]]))
    told = valley.step(state)["next", "observation"][0, -4:]
    torch.testing.assert_close(told, torch.tensor([0.25, 0.0, 0.0, 0.5]))
    valley.close()
