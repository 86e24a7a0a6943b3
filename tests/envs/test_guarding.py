"""Guards know the vehicle and the LiDAR of their environment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torchrl.envs import TransformedEnv

from uavrl import load_policy
from uavrl.envs import NavigationEnv
from uavrl.envs.guarding import guarded, looks_around
from uavrl.envs.gym import ValleyEnv
from uavrl.envs.sensors import lidar_sensor, sensor_of_view
from uavrl.errors import UavrlError
from uavrl.transforms import NavigationState
from uavrl.transforms.guarded import Guarded
from uavrl.transforms.reduction import in_view as torch_in_view
from uavrl_onboard.guards.settings import guard_settings
from uavrl_onboard.perception.view import in_view, is_view

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


def test_a_policy_with_a_limit_of_its_own_keeps_it_behind_guards() -> None:
    base = NavigationEnv(1, world=SMALL, lidar={"max_range": 4.0, "far_range": 12.0}, max_speed=6.0)
    assert guarded(base, guard_settings("all")).vehicle.velocity_limit == 6.0
    assert guarded(base, guard_settings("all"), 2.0).vehicle.velocity_limit == 2.0
    flown = load_policy("best").make_env("env=dynamic", "env.max_speed=6", num_uavs=1, guards=["evasion"])
    around = next(part for part in flown.transform.modules() if isinstance(part, Guarded))
    assert around.vehicle.velocity_limit == 2.0, "as it was trained"
    assert flown.base_env.max_speed == 6.0
    own = TransformedEnv(base, guarded(base, guard_settings("evasion"), 2.0))
    fast = own.reset().set("action", torch.full((1, 4), 6.0))
    assert own.step(fast)["next", "flown_action"].abs().max() <= 2.0


@pytest.mark.parametrize(
    ("azimuths", "view"),
    [
        ((140.0, 220.0), (140.0, 220.0)),
        ((90.0, 270.0), (90.0, 270.0)),
        ((-45.0, 45.0), (-45.0, 45.0)),
        ((-200.0, -100.0), (160.0, 260.0)),
    ],
)
def test_a_sensor_that_looks_backwards_has_a_field_of_view_there(
    azimuths: tuple[float, float], view: tuple[float, float], tmp_path: Path
) -> None:
    low, high = azimuths
    around = np.arange(low, high + 0.5)
    np.save(tmp_path / "rays.npy", np.stack([around, np.zeros_like(around)], -1))
    sensor = lidar_sensor({"directions": str(tmp_path / "rays.npy")})
    assert sensor.field_of_view[:2] == view and is_view(sensor.field_of_view)
    assert not looks_around(sensor)
    rays = sensor.rays.directions[0]
    assert in_view(*rays.T, sensor.field_of_view).all()
    assert torch_in_view(torch.from_numpy(rays.copy()), sensor.field_of_view).all()
    against = -rays * np.array([1.0, 1.0, -1.0], np.float32)
    assert in_view(*against.T, sensor.field_of_view).sum() <= max(0, len(rays) - 178)
    assert sensor_of_view("known", sensor.field_of_view).field_of_view == pytest.approx(sensor.field_of_view, abs=0.11)


@pytest.mark.parametrize("name", ["vlp16", "os0_32", "mid360", "rplidar"])
def test_a_tilted_lidar_does_not_see_the_same_on_all_sides(name: str) -> None:
    level = [(0, 0, 0), (180, 0, 0), (0, 0, 90), (4, 0, 0), (180, -4, 30)]
    tilted = [(0, 20, 0), (0, 45, 0), (0, 70, 0), (0, 85, 0), (0, 90, 0), (90, 0, 0), (180, 20, 0), (6, 0, 0)]
    for mount in (*level, *tilted):
        assert looks_around(lidar_sensor({"like": name, "mount": mount})) == (mount in level), mount


def test_slow_vehicles_turn_as_their_environment_allows() -> None:
    base = NavigationEnv(1, world=SMALL, lidar={"max_range": 4.0, "far_range": 12.0}, max_speed=1.0)
    assert guarded(base, guard_settings("all")).vehicle.yaw_rate_limit == base.action_spec.space.high.max() == 1.0


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
