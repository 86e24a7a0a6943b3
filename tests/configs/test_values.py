"""What the yaml files compose to, and what of a command line is refused by name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from tests.helpers.configs import changed, composed
from uavrl.configs import EvaluateConfig, TrainConfig, checked, complete, conf_dir, learner_name, to_dataclass
from uavrl.configs.choices import known_keys
from uavrl.configs.limits import MOST
from uavrl.configs.parts import PARTS
from uavrl.envs.world import LARGEST, WorldConfig
from uavrl.errors import UavrlError

FILES = sorted((path.parent.name, path.stem) for path in conf_dir().glob("*/*.yaml"))
CHOICES = [file for file in FILES if file[0] not in ("pretrain", "scheme", "experiment", "learner", "preset")]
YAML_FILES = sorted(conf_dir().rglob("*.yaml"))


def settings(*overrides: str) -> TrainConfig:
    return to_dataclass(composed("config", *overrides))


def plain(node: Any) -> Any:
    return OmegaConf.to_container(node)


def part(group: str, *overrides: str) -> dict[str, Any]:
    return plain(getattr(settings(*overrides), group))


# ---------------------------------------------------------------------- composing


@pytest.mark.parametrize(("group", "name"), CHOICES)
def test_every_choice_composes_for_training_and_says_so(group: str, name: str) -> None:
    config = settings(f"{group}={name}")
    assert config.choices[group] == name
    assert group not in PARTS or (getattr(config, group)._target_ is None) == (name == "none")


@pytest.mark.parametrize("name", ["static", "dynamic"])
def test_every_environment_composes_for_evaluation(name: str) -> None:
    config = checked(composed("evaluate", f"env={name}"), EvaluateConfig)
    assert config.choices["env"] == name


@pytest.mark.parametrize("algo", ["td3", "ddpg", "sac"])
@pytest.mark.parametrize("enhancers", [[], ["fork=on", "lifeguard=mlp"]], ids=["bare", "enhanced"])
def test_what_a_run_writes_is_read_as_it_was(algo: str, enhancers: list[str], tmp_path: Path) -> None:
    config = complete(composed("config", f"algo={algo}", "run_dir=here", "env=dynamic", *enhancers))
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    again = OmegaConf.load(tmp_path / "config.yaml")
    assert complete(again) == config
    assert to_dataclass(again) == to_dataclass(config)


def test_a_configuration_that_names_no_classes_is_of_an_older_uavrl() -> None:
    old = OmegaConf.create({"algo": {"name": "td3", "gamma": 0.99}, "env": {"name": "static"}, "seed": 0})
    with pytest.raises(UavrlError, match=r"older uavrl, which named no classes: start a new run"):
        to_dataclass(old)


@pytest.mark.parametrize("path", YAML_FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_key_has_a_comment(path: Path) -> None:
    lines = path.read_text().splitlines()
    hydra = next((i for i, line in enumerate(lines) if line.startswith("hydra:")), len(lines))
    bare = [
        line
        for line in lines[:hydra]
        if re.match(r"\s*\w+:", line)
        and "#" not in line
        and not re.match(r"\s*(defaults|_target_|name|world|trainer|algo|env|buffer):", line)
    ]
    assert not bare


# ---------------------------------------------------------------------- what is told of another choice


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ([], "td3"),
        (["learner=td3_lg"], "td3_lg"),
        (["fork=on", "lifeguard=mlp"], "td3_fork_lg_mlp"),
        (["algo=ddpg", "fork=on", "backward_reward=abr"], "ddpg_fork_abr"),
    ],
)
def test_run_folders_are_named_for_what_learns(overrides: list[str], name: str) -> None:
    config = composed("config", *overrides)
    assert learner_name(config.choices) == name
    assert f"_static_{name}_navigation_prize_seed0" in config.run_dir


@pytest.mark.parametrize("reward", ["navigation", "navigation_prize"])
def test_a_collision_costs_less_with_lifeguard(reward: str) -> None:
    def cost(*overrides: str) -> float:
        return settings(f"reward={reward}", *overrides).reward.collided_reward

    assert (cost(), cost("fork=on")) == (-50.0, -50.0)
    assert (cost("lifeguard=linear"), cost("algo=sac", "lifeguard=mlp")) == (-10.0, -10.0)
    assert cost("lifeguard=linear", "reward.collided_reward=-50") == -50.0


def test_forks_weight_fades_at_a_return_that_the_reward_can_reach() -> None:
    def fades_at(*overrides: str) -> float:
        return settings("fork=on", *overrides).fork.max_reward

    assert (fades_at(), fades_at("reward=navigation"), fades_at("scheme=abr_plus")) == (460.0, 460.0, 460.0)
    assert (fades_at("reward=traditional"), fades_at("scheme=tr")) == (66.0, 66.0)
    assert fades_at("scheme=tr", "fork.max_reward=80") == 80.0


def test_the_prize_is_what_loitering_for_ever_would_earn() -> None:
    prize, thesis = part("reward", "reward=navigation_prize"), part("reward", "reward=navigation")
    assert thesis.pop("arrived_reward") == 0.0
    gamma = part("algo")["gamma"]
    assert prize.pop("arrived_reward") == pytest.approx(sum(thesis["weights"][1:]) / (1 - gamma))
    assert prize == thesis


def test_the_dynamic_environment_differs_in_its_planes_only() -> None:
    dynamic, static = part("env", "env=dynamic"), part("env")
    assert dynamic["world"].pop("planes") == 3 and static["world"].pop("planes") == 0
    assert dynamic == static


def test_the_lidars_range_and_the_observations_altitude_follow() -> None:
    assert settings("perception.radius=5.5").perception.lidar.max_range == 5.5
    assert settings("env.world.flight_level=3").perception.flight_level == 3.0


def test_short_runs_begin_with_fewer_random_steps() -> None:
    begins = [settings(*short).algo.random_steps for short in ([], ["trainer.steps=30000"], ["trainer.episodes=1000"])]
    assert begins == [10_000, 3_000, 5_000]


def test_the_fast_preset_leaves_the_default_as_it_is_and_can_be_changed_in_turn() -> None:
    plain_run, fast = settings(), settings("preset=fast", "algo.n_steps=5", "collector=sync")
    assert (plain_run.algo.n_steps, plain_run.algo.layer_norm, plain_run.algo.exploration_spread) == (1, False, 1.0)
    assert (plain_run.buffer.mirror, plain_run.trainer.until_success) == (False, None)
    assert (fast.algo.n_steps, fast.algo.critic.layer_norm, fast.buffer.mirror) == (5, True, True)
    assert fast.algo.actor.hidden == [256, 256]
    assert [fast.choices[group] for group in ("collector", "backward_reward", "reward")] == [
        "sync",
        "abr",
        "navigation_prize",
    ]
    assert settings("preset=fast", "env=dynamic").env.world.planes == 3


# ---------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["buffer.mirror=true", "perception.angles=raw"], r"buffer\.mirror must be false, but with uavrl"),
        (["buffer.mirror=true", "perception.angles=turns"], r"buffer\.mirror must be false, but with uavrl"),
        (["fork=on", "algo.n_steps=3"], r"algo\.n_steps must be 1 with FORK or LifeGuard"),
        (["lifeguard=mlp", "algo.n_steps=3"], r"algo\.n_steps must be 1 with FORK or LifeGuard"),
        (["trainer.until_success=80"], r"trainer\.until_success must be in \(0, 1\], got 80"),
        (["env.airframe.mass=-1"], r"env\.airframe: Mass, inertia"),
    ],
)
def test_what_does_not_go_together_is_refused(overrides: list[str], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        settings(*overrides)


def test_every_key_that_has_a_most_is_one() -> None:
    known = {key for name in ("config", "evaluate", "pretrain", "replay") for key in known_keys(name)}
    assert not {*MOST} - known
    assert not {*LARGEST} - {field.name for field in fields(WorldConfig)}


OUT_OF_RANGE = """
    seed=-1
    env.num_uavs=0 env.max_steps=0
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
    algo.policy_noise=-1 algo.noise_clip=-1 algo.exploration_noise=-0.1 algo.random_steps=-1 algo.hidden=[]
    algo.hidden=[400,0]
    buffer.capacity=0
    collector.steps_per_batch=0
    trainer.episodes=0 trainer.steps=0 trainer.updates_per_step=0 trainer.window=0 trainer.checkpoint_interval=0
    trainer.keep_checkpoints=0 trainer.threads=0 trainer.execution=fast trainer.products=blas
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
        to_dataclass(changed([], override))


@pytest.mark.parametrize(
    ("choices", "override"),
    [(choices, override) for choices, overrides in OUT_OF_RANGE_OF_CHOICES.items() for override in overrides.split()],
)
def test_values_of_choices_out_of_range_are_refused_by_name(choices: str, override: str) -> None:
    with pytest.raises(UavrlError, match=rf"{re.escape(override.partition('=')[0])} must be"):
        to_dataclass(changed(choices.split(), override))


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("key", NOT_FINITE)
def test_what_is_no_finite_number_is_refused_by_name(key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=rf"{re.escape(key)} must be a finite number"):
        to_dataclass(changed([], f"{key}={value}"))


OUT_OF_RANGE_OF_EVALUATION = """
    episodes=0 num_uavs=0 threads=0 products=blas seed=-1 valleys=[] valleys=[-1] env.max_steps=0
"""


@pytest.mark.parametrize("override", OUT_OF_RANGE_OF_EVALUATION.split())
def test_evaluation_refuses_values_out_of_range_by_name(override: str) -> None:
    with pytest.raises(UavrlError, match=re.escape(override.partition("=")[0])):
        checked(changed([], override, name="evaluate"), EvaluateConfig)


def test_a_part_left_out_is_refused_by_name() -> None:
    config = composed()
    del config.reward
    with pytest.raises(UavrlError, match="reward is not in the configuration: choose one with reward=NAME"):
        to_dataclass(config)


def test_a_missing_value_is_refused_by_name() -> None:
    with pytest.raises(UavrlError, match=r"algo\.gamma"):
        settings("algo.gamma=???")


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("algo.gamma", "much", "algo.gamma must be a number, got 'much'"),
        ("algo.batch_size", "1.5", "algo.batch_size must be a whole number, got 1.5"),
        ("algo.batch_size", "true", "algo.batch_size must be a whole number, got True"),
        ("perception.blind", "1", "perception.blind must be true or false, got 1"),
        ("algo.hidden", "400", "algo.hidden must be a list, got 400"),
        ("env.airframe", "3", "env.airframe must be the settings of Airframe, got 3"),
        ("reward", "null", "reward must be a part with a _target_, got None"),
        ("algo.critic", "other", "algo.critic must be a part with a _target_, got 'other'"),
        ("lifeguard.model", "5", "lifeguard.model must be one of linear, mlp, got 5"),
    ],
)
def test_values_of_another_type_are_refused_by_name(key: str, value: str, said: str) -> None:
    with pytest.raises(UavrlError, match=re.escape(said)):
        to_dataclass(changed(["lifeguard=linear"], f"{key}={value}"))


def test_whole_numbers_are_numbers() -> None:
    assert isinstance(to_dataclass(changed([], "algo.tau=1")).algo.tau, float)


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
        to_dataclass(config)


def test_every_part_names_a_class_and_every_value_a_plain_one() -> None:
    def leaves(node: Any) -> list[Any]:
        return [leaf for child in node.values() for leaf in leaves(child)] if isinstance(node, Mapping) else [node]

    config = plain(complete(composed("config", "fork=on", "lifeguard=mlp")))
    assert all("_target_" in config[group] for group in PARTS)
    assert all(isinstance(leaf, bool | int | float | str | list | None) for leaf in leaves(config))
