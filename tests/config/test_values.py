"""What of a command line is refused by name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import pytest
from omegaconf import OmegaConf

from tests.helpers.configs import changed, composed
from uavrl.config import EvaluateConfig, resolve, validate
from uavrl.config.parts import PARTS
from uavrl.errors import UavrlError


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["trainer.until_success=80"], r"trainer\.until_success must be in \(0, 1\), got 80"),
        (["env.airframe.mass=-1"], r"env\.airframe: Mass, inertia"),
    ],
)
def test_what_does_not_go_together_is_refused(overrides: list[str], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        validate(composed("config", *overrides))


OUT_OF_RANGE = """
    seed=-1
    env.num_uavs=0 env.max_steps=0 env.max_speed=0 env.max_speed=11 env.lidar=vlp61
    env.world.seeds=[] env.world.seeds=[-1] env.world.size=[40.0,0.0] env.world.obstacles=-1
    env.world.obstacles=[] env.world.obstacles=[45,-1]
    env.world.obstacle_scale=0 env.world.flight_level=-1 env.world.ceiling=-8 env.world.goal_radius=0
    env.world.min_goal_distance=-1 env.world.min_clearance=-1 env.world.uav_radius=0 env.world.planes=-3
    env.world.plane_speed=[4.0,2.5] env.world.plane_wingspan=0 env.world.plane_keep_out=-1
    env.airframe.mass=0 env.airframe.inertia=[0.0,1.0,1.0] env.airframe.arm=-1 env.airframe.torque_to_thrust=0
    env.airframe.max_total_thrust=10 env.airframe.tilt_limit=2 env.airframe.collision_radius=0
    env.airframe.collision_height=-1 env.airframe.lidar_diameter=0 env.airframe.lidar_height=0
    env.aerodynamics.gust_time_constant=0
    perception.frames=0 perception.statistic=mean perception.angles=rad perception.blind_to=rocks
    perception.lidar.max_range=0 perception.lidar.min_range=5 perception.lidar.range_noise=-0.1
    perception.lidar.dropout=1
    reward.weights=[1.0,2.0] reward.flight_level=0 reward.altitude_term=square
    algo.gamma=1 algo.tau=0 algo.batch_size=0 algo.actor_lr=0 algo.critic_lr=-1 algo.policy_delay=0
    algo.policy_noise=-1 algo.noise_clip=-1 algo.exploration_noise=-0.1 algo.learning_starts=-1 algo.hidden=[]
    algo.hidden=[400,0]
    buffer.capacity=0
    collector.steps_per_batch=0
    trainer.episodes=0 trainer.steps=0 trainer.updates_per_step=0 trainer.window=0 trainer.checkpoint_interval=0
    trainer.keep_checkpoints=0 trainer.threads=0 trainer.execution=fast trainer.matmul=blas
    logger.interval=0
"""
OUT_OF_RANGE_OF_CHOICES = {
    "fork=on lifeguard=linear": """
        fork.system_network.hidden=[] fork.reward_network.hidden=[0] fork.model_lr=0
        fork.threshold=0 fork.max_reward=-1 fork.base_weight=-0.6 fork.return_window=0 lifeguard.model=tree
        lifeguard.penalty=none lifeguard.penalty_weight=-10 lifeguard.success_window=0 lifeguard.capacity=0
        lifeguard.batch_size=7 lifeguard.min_evaluations=-1 lifeguard.evaluation_window=0
        lifeguard.min_true_negative_rate=1 lifeguard.model_lr=0 lifeguard.alpha=0
    """,
    "backward_reward=abr": """
        backward_reward.multiplier=-0.2 backward_reward.threshold=1.1 backward_reward.max_classes=0
        backward_reward.seed=-1
    """,
    "backward_reward=abr_plus": "backward_reward.multiplier=-0.2",
    "algo=sac": "algo.temperature_lr=-1 algo.gamma=-1",
    "perception.lidar.max_range=4": "perception.radius=0",
    "buffer=prioritized": "buffer.alpha=1.5 buffer.beta=-0.1",
}
NOT_FINITE = ["algo.gamma", "algo.actor_lr", "trainer.updates_per_step", "env.world.ceiling", "env.airframe.mass"]


@pytest.mark.parametrize("override", OUT_OF_RANGE.split())
def test_values_out_of_range_are_refused_by_name(override: str) -> None:
    name = override.partition("=")[0].rpartition(".")[2]
    with pytest.raises(UavrlError, match=rf"(?i)\b{name}\b"):
        validate(changed([], override))


@pytest.mark.parametrize(
    ("choices", "override"),
    [(choices, override) for choices, overrides in OUT_OF_RANGE_OF_CHOICES.items() for override in overrides.split()],
)
def test_values_of_choices_out_of_range_are_refused_by_name(choices: str, override: str) -> None:
    with pytest.raises(UavrlError, match=rf"{re.escape(override.partition('=')[0])} must be"):
        validate(changed(choices.split(), override))


@pytest.mark.parametrize("value", ["0", "nan", "abc", "[2]"])
def test_a_value_that_another_part_takes_over_is_refused_by_the_key_that_was_given(value: str) -> None:
    with pytest.raises(UavrlError, match=r"^env\.max_speed must be"):
        validate(composed("config", f"env.max_speed={value}"))


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("key", NOT_FINITE)
def test_what_is_no_finite_number_is_refused_by_name(key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=rf"{re.escape(key)} must be a finite number"):
        validate(changed([], f"{key}={value}"))


OUT_OF_RANGE_OF_EVALUATION = """
    episodes=0 num_uavs=0 threads=0 matmul=blas seed=-1 valleys=[] valleys=[-1] env.max_steps=0
"""


@pytest.mark.parametrize("override", OUT_OF_RANGE_OF_EVALUATION.split())
def test_evaluation_refuses_values_out_of_range_by_name(override: str) -> None:
    with pytest.raises(UavrlError, match=re.escape(override.partition("=")[0])):
        validate(changed([], override, name="evaluate"), EvaluateConfig)


def test_a_part_left_out_is_refused_by_name() -> None:
    config = composed()
    del config.reward
    with pytest.raises(UavrlError, match="reward is not in the configuration: choose one with reward=NAME"):
        validate(config)


def test_a_missing_value_is_refused_by_name() -> None:
    with pytest.raises(UavrlError, match=r"^algo\.gamma must be given, and is not: add algo\.gamma=VALUE\.$"):
        validate(composed("config", "algo.gamma=???"))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("algo.gamma", "much", "algo.gamma must be a number, got 'much'"),
        ("algo.batch_size", "1.5", "algo.batch_size must be a whole number, got 1.5"),
        ("algo.batch_size", "true", "algo.batch_size must be a whole number, got True"),
        ("perception.blind", "1", "perception.blind must be true or false, got 1"),
        ("algo.hidden", "400", "algo.hidden must be a list, got 400"),
        ("env.airframe", "3", "env.airframe must be the settings of Airframe (mass, inertia, arm, …), got 3"),
        ("reward", "null", "reward must be a part with a _target_, got None"),
        ("algo.critic", "other", "algo.critic must be a part with a _target_, got 'other'"),
        ("lifeguard.model", "5", "lifeguard.model must be one of linear, mlp, got 5"),
    ],
)
def test_values_of_another_type_are_refused_by_name(key: str, value: str, said: str) -> None:
    with pytest.raises(UavrlError, match=re.escape(said)):
        validate(changed(["lifeguard=linear"], f"{key}={value}"))


def test_whole_numbers_are_numbers() -> None:
    assert isinstance(validate(changed([], "algo.tau=1")).algo.tau, float)


@pytest.mark.parametrize(
    ("where", "key", "said"),
    [
        ("algo", "gama", "There is no key 'algo.gama': did you mean algo.gamma?"),
        ("env.world", "ceilling", "There is no key 'env.world.ceilling': did you mean env.world.ceiling?"),
        ("algo.actor", "hiden", "There is no key 'algo.actor.hiden': did you mean algo.actor.hidden?"),
        ("reward", "name", "There is no key 'reward.name'"),
    ],
)
def test_keys_that_nothing_takes_are_refused(where: str, key: str, said: str) -> None:
    config = composed()
    OmegaConf.set_struct(config, False)
    OmegaConf.update(config, f"{where}.{key}", 1)
    with pytest.raises(UavrlError, match=re.escape(said)):
        validate(config)


def test_every_part_names_a_class_and_every_value_a_plain_one() -> None:
    def leaves(node: Any) -> list[Any]:
        return [leaf for child in node.values() for leaf in leaves(child)] if isinstance(node, Mapping) else [node]

    config = OmegaConf.to_container(resolve(composed("config", "fork=on", "lifeguard=mlp")))
    assert all("_target_" in config[group] for group in PARTS)
    assert all(isinstance(leaf, bool | int | float | str | list | None) for leaf in leaves(config))
