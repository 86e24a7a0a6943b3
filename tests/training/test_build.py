"""The environments that a run builds."""

from pathlib import Path

import pytest

from tests.helpers.commands import VALLEY
from tests.helpers.configs import composed
from tests.helpers.exported import policy_folder
from uavrl import load_policy
from uavrl.config import validate
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import default_guards
from uavrl.losses.networks import network_sizes
from uavrl.training.build import make_flight, make_training_env

SMALL = [*VALLEY, "env.num_uavs=2", "run_dir=here"]


def settings_of(*overrides: str) -> TrainConfig:
    return validate(composed("config", *SMALL, *overrides))


def test_a_training_casts_fewer_rays_with_a_stride_and_its_validations_cast_all() -> None:
    settings = settings_of("trainer.lidar_stride=4", "perception=range_image")
    env = make_training_env(settings, seed=0)
    flight = make_flight(settings, network_sizes(env))
    whole = make_training_env(settings_of("perception=range_image"), seed=0)
    assert (env.num_rays, flight.env.num_rays, whole.num_rays) == (28_928 // 4, 28_928, 28_928)
    seen, all_seen = (each.reset()["observation"] for each in (env, whole))
    assert seen.shape == all_seen.shape
    assert (seen[:, -seen.shape[1] // 3 :][:, :72] > 0).any()  # the newest scan: something is near
    for each in (env, flight.env, whole):
        each.close()


def test_a_training_flies_behind_its_guards_and_so_do_its_validations() -> None:
    settings = settings_of("guards=[map,shield]", "demonstrator=vfh", "perception.last_action=true")
    env = make_training_env(settings, seed=0)
    flight = make_flight(settings, network_sizes(env))
    for each in (env, flight.env):
        assert each.base_env.lidar_config.far_range == 12.0  # as far as the map looks
        assert {"flown_action", "goal_heading_deg"} <= set(each.observation_spec.keys())
        each.close()
    with pytest.raises(UavrlError, match="There is no guard 'shielded'"):
        settings_of("guards=[shielded]")


def test_a_policy_flies_with_the_guards_of_its_training_unless_others_are_asked_for(tmp_path: Path) -> None:
    folder = policy_folder(tmp_path / "run", "guards=[shield]")
    assert default_guards(folder).names == ("shield",)
    assert load_policy(folder).guards.names == ("shield",)
    assert load_policy(folder, guards="none").guards.names == ()


def test_a_stride_needs_a_lidar() -> None:
    settings = settings_of("trainer.lidar_stride=4")
    del settings.perception["lidar"]
    with pytest.raises(UavrlError, match=r"trainer\.lidar_stride must be 1 with a perception without a LiDAR, got 4"):
        make_training_env(settings, seed=0)
