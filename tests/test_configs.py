"""Yaml, dataclass and constructor say the same; what is out of range is refused by name."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest
import yaml
from omegaconf import OmegaConf

from tests.composing import changed, composed
from uavrl.buffers import BackwardReward, FailureBias
from uavrl.configs import EvaluateConfig, TrainConfig, conf_dir, learner, to_dataclass
from uavrl.configs.algo import DDPGConfig, ForkConfig, LifeGuardConfig, SACConfig, TD3Config
from uavrl.configs.buffer import ABRConfig, ABRPlusConfig, FailureBiasedBufferConfig, PrioritizedBufferConfig
from uavrl.configs.choices import known_keys
from uavrl.configs.limits import MOST
from uavrl.configs.memory import bytes_needed
from uavrl.configs.train import GROUPS, LoggerConfig
from uavrl.configs.valley import EnvConfig, NavigationRewardConfig, PerceptionConfig, TraditionalRewardConfig
from uavrl.configs.walker import BipedalConfig, WalkerRewardConfig
from uavrl.envs.bipedal import BipedalEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.limits import LARGEST
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl.losses import DDPGLoss, Fork, LifeGuard, TD3Loss
from uavrl.models import Actor, Critic, GaussianActor, OneShotClassifier, RewardNet, SystemNet
from uavrl.training.stepper import ActorCriticStepper
from uavrl.transforms import (
    NavigationObservation,
    NavigationReward,
    TraditionalReward,
    TruncatedIcosahedron,
    WalkerReward,
    navigation_state,
)

FILES = sorted((path.parent.name, path.stem) for path in conf_dir().glob("*/*.yaml"))
# tests/pretraining/test_config.py has the first, tests/test_experiments.py the others
FILES = [file for file in FILES if file[0] not in ("pretrain", "scheme", "preset", "experiment")]
CHOICES = [file for file in FILES if file[0] != "enhancer"]  # an enhancer is part of an algorithm
WALKERS = {("perception", "none"), ("reward", "walker"), ("buffer", "failure_biased")}  # they go with the walker alone
YAML_FILES = sorted(conf_dir().rglob("*.yaml"))


def settings(name: str = "config", *overrides: str) -> Any:
    return to_dataclass(composed(name, *overrides))


def choosing(group: str, name: str) -> list[str]:
    """The overrides that choose a group's member, with the environment that it needs."""
    return [f"{group}={name}", *(["env=bipedal_hardcore"] if (group, name) in WALKERS else [])]


def plain(value: Any) -> Any:
    """Tuples as lists, however deep: yaml knows no tuples."""
    if isinstance(value, dict):
        return {key: plain(child) for key, child in value.items()}
    return [plain(child) for child in value] if isinstance(value, list | tuple) else value


def keys(node: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in node.items():
        yield f"{prefix}{key}"
        if isinstance(value, dict):
            yield from keys(value, f"{prefix}{key}.")


def all_fields(schema: Any, prefix: str = "") -> Iterator[str]:
    for field in fields(schema):
        yield f"{prefix}{field.name}"
        if is_dataclass(getattr(schema, field.name)):
            yield from all_fields(getattr(schema, field.name), f"{prefix}{field.name}.")


def signature(*functions: Any) -> dict[str, Any]:
    """Defaults of all keyword arguments of some constructors."""
    return {
        name: parameter.default
        for function in functions
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.default is not inspect.Parameter.empty
    }


# ---------------------------------------------------------------------- composing


def test_every_yaml_of_a_group_has_a_schema_and_every_schema_a_yaml() -> None:
    assert sorted((group, name) for group, names in GROUPS.items() for name in names) == FILES


@pytest.mark.parametrize(("group", "name"), CHOICES)
def test_every_choice_composes_for_training(group: str, name: str) -> None:
    config = settings("config", *choosing(group, name))
    assert isinstance(config, TrainConfig)
    assert type(getattr(config, group)) is GROUPS[group][name]
    assert getattr(getattr(config, group), "name", name) == name


@pytest.mark.parametrize(("group", "name"), [choice for choice in CHOICES if choice[0] in ("env", "perception")])
def test_every_choice_composes_for_evaluation(group: str, name: str) -> None:
    config = settings("evaluate", f"{group}={name}")
    assert isinstance(config, EvaluateConfig)
    assert getattr(config, group).name == name


SAVED = zip(
    sorted(GROUPS["algo"]), cycle(["navigation", "navigation_prize", "traditional"]), cycle(["uniform", "prioritized"])
)


@pytest.mark.parametrize(("algo", "reward", "buffer"), SAVED)
def test_a_saved_configuration_gets_its_types_back(algo: str, reward: str, buffer: str, tmp_path: Path) -> None:
    config = composed("config", f"algo={algo}", f"reward={reward}", f"buffer={buffer}", "run_dir=here", "env=dynamic")
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    assert to_dataclass(OmegaConf.load(tmp_path / "config.yaml")) == to_dataclass(config)


def test_a_saved_configuration_of_an_unknown_algorithm_is_refused() -> None:
    saved = OmegaConf.create(OmegaConf.to_yaml(composed("config", "run_dir=here"), resolve=True))
    saved.algo.name = "ppo"
    with pytest.raises(UavrlError, match=r"algo\.name must be one of td3, .*sac_lg, got 'ppo'"):
        to_dataclass(saved)


# ---------------------------------------------------------------------- yaml, dataclass, signature


ENHANCED = {
    "td3_fork": ("td3", {"fork"}),
    "td3_lg": ("td3", {"lifeguard"}),
    "td3_fork_lg": ("td3", {"fork", "lifeguard"}),
    "ddpg_lg": ("ddpg", {"lifeguard"}),
    "sac_lg": ("sac", {"lifeguard"}),
    "td3_lg_walker": ("td3_walker", {"lifeguard"}),
}
# What these change of another choice is tested below.
DERIVED = [
    ("env", "dynamic"),
    ("reward", "navigation_prize"),
    ("collector", "async"),
    *(("algo", name) for name in ENHANCED),
]
DERIVED += [("algo", "td3_walker"), ("algo", "td3_fork_walker")]


@pytest.mark.parametrize(("group", "name"), [choice for choice in CHOICES if choice not in DERIVED])
def test_yaml_holds_every_field_and_the_default_of_the_dataclass(group: str, name: str) -> None:
    written = yaml.safe_load((conf_dir() / group / f"{name}.yaml").read_text())
    del written["defaults"]
    default = GROUPS[group][name]()
    assert set(keys(written)) == set(all_fields(default))
    resolved = plain(asdict(getattr(settings("config", *choosing(group, name)), group)))
    expected = plain(asdict(default))
    if "name" in expected:
        expected["name"] = name
    assert resolved == expected


@pytest.mark.parametrize("name", ["fork", "lifeguard"])
def test_an_enhancers_yaml_holds_every_field_and_the_default_of_the_dataclass(name: str) -> None:
    schema = GROUPS["enhancer"][name]
    written = yaml.safe_load((conf_dir() / "enhancer" / f"{name}.yaml").read_text())
    del written["defaults"]
    defaults = plain(asdict(schema()))
    assert written.keys() == defaults.keys()
    literal = {key for key, value in written.items() if "${" not in str(value)}  # the others are composed below
    assert len(literal) >= len(written) - 1
    assert plain({key: written[key] for key in literal}) == {key: defaults[key] for key in literal}


@pytest.mark.parametrize("name", ENHANCED)
def test_an_enhanced_algorithm_is_its_base_with_the_enhancers(name: str) -> None:
    base, enhancers = ENHANCED[name]
    enhanced, plain_base = (asdict(settings("config", f"algo={algo}").algo) for algo in (name, base))
    assert enhanced.pop("name") == name and plain_base.pop("name") == base
    for enhancer, schema in (("fork", ForkConfig), ("lifeguard", LifeGuardConfig)):
        assert plain_base.pop(enhancer) is None
        assert plain(enhanced.pop(enhancer)) == (plain(asdict(schema())) if enhancer in enhancers else None)
    assert enhanced == plain_base


def changes(algo: str, base: str) -> dict[str, Any]:
    """The values of an algorithm that are not those of another."""
    one, other = (asdict(settings("config", f"algo={name}").algo) for name in (algo, base))
    return plain({key: value for key, value in one.items() if value != other[key]})


def test_the_walkers_td3_has_the_numbers_of_the_published_code() -> None:
    assert changes("td3_walker", "td3") == {"name": "td3_walker", "actor_lr": 1e-3}
    assert changes("td3_fork_walker", "td3_fork") == {
        "name": "td3_fork_walker",
        "tau": 0.02,
        "actor_lr": 3e-4,
        "critic_lr": 3e-4,
        "hidden": [256, 256],
        "fork": plain(asdict(ForkConfig(variant="bipedal", threshold=0.02, max_reward=300.0, base_weight=1.0))),
    }


def test_the_walker_brings_its_observation_its_reward_and_its_buffer() -> None:
    def names(*overrides: str) -> list[str]:
        config = settings("config", *overrides)
        return [config.perception.name, config.reward.name, config.buffer.name]

    assert names("env=bipedal_hardcore") == ["none", "walker", "failure_biased"]
    assert names("env=bipedal_hardcore", "buffer=uniform") == ["none", "walker", "uniform"]
    assert names("env=dynamic") == ["truncated_icosahedron", "navigation_prize", "uniform"]


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["env=bipedal_hardcore", "perception=truncated_icosahedron"], "perception must be none with env=bipedal_hard"),
        (["env=bipedal_hardcore", "reward=traditional"], "reward must be walker with env=bipedal_hardcore"),
        (["env=bipedal_hardcore", "reward=navigation"], "reward must be walker with env=bipedal_hardcore"),
        (["env=bipedal_hardcore", "backward_reward=abr"], "backward_reward must be none with env=bipedal_hardcore"),
        (["reward=walker"], "reward must be navigation or navigation_prize or traditional with env=static"),
        (["buffer=failure_biased"], "buffer must be uniform or prioritized with env=static"),
        (["perception=none"], "perception must be truncated_icosahedron with env=static"),
        (["buffer.mirror=true", "perception.angles=raw"], r"buffer\.mirror must be false, but in the valley"),
        (["buffer.mirror=true", "env=bipedal_hardcore"], r"buffer\.mirror must be false, but in the valley"),
        (["algo=td3_fork", "algo.n_steps=3"], r"algo\.n_steps must be 1 with FORK or LifeGuard"),
        (["algo=td3_lg", "algo.n_steps=3"], r"algo\.n_steps must be 1 with FORK or LifeGuard"),
        (["collector.processes=2"], r"collector\.processes must be 1, or with collector=async more, got 2"),
        (["trainer.until_success=80"], r"trainer\.until_success must be null or a share in \(0, 1\], got 80"),
    ],
)
def test_what_does_not_go_together_is_refused(overrides: list[str], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        settings("config", *overrides)


def test_enhancers_attach_to_any_algorithm_by_override() -> None:
    algo = settings("config", "algo=ddpg", "+enhancer@algo.fork=fork", "+enhancer@algo.lifeguard=lifeguard").algo
    assert plain(asdict(algo.fork)) == plain(asdict(ForkConfig()))
    assert algo.lifeguard == LifeGuardConfig()


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ([], "td3"),
        (["algo=td3_lg"], "td3_lg"),
        (["algo=td3_fork_lg", "algo.lifeguard.model=mlp"], "td3_fork_lg_mlp"),
        (["algo=td3_lg", "algo.lifeguard=null"], "td3"),
        (["algo=ddpg", "+enhancer@algo.fork=fork", "backward_reward=abr"], "ddpg_fork_abr"),
        (["algo=td3_fork_walker"], "td3_fork"),
    ],
)
def test_run_folders_are_named_for_what_learns(overrides: list[str], name: str) -> None:
    config = composed("config", *overrides)
    assert learner(config) == name
    assert f"_static_{name}_navigation_prize_seed0" in config.run_dir


@pytest.mark.parametrize("reward", ["navigation", "navigation_prize"])
def test_a_collision_costs_less_with_lifeguard(reward: str) -> None:
    def cost(*overrides: str) -> float:
        return settings("config", f"reward={reward}", *overrides).reward.collided_reward

    assert (cost(), cost("algo=td3_fork")) == (-50.0, -50.0)
    assert (cost("algo=td3_lg"), cost("algo=sac_lg")) == (-10.0, -10.0)
    assert cost("algo=td3_lg", "algo.lifeguard=null") == -50.0
    assert cost("algo=td3_lg", "reward.collided_reward=-50") == -50.0


def test_forks_weight_fades_at_a_return_that_the_reward_can_reach() -> None:
    def fades_at(*overrides: str) -> float:
        fork = settings("config", "algo=td3_fork", *overrides).algo.fork
        assert fork is not None
        return fork.max_reward

    assert (fades_at(), fades_at("reward=navigation"), fades_at("scheme=abr_plus")) == (460.0, 460.0, 460.0)
    assert (fades_at("reward=traditional"), fades_at("scheme=tr")) == (66.0, 66.0)
    assert fades_at("scheme=tr", "algo.fork.max_reward=80") == 80.0


def test_the_prize_is_what_loitering_for_ever_would_earn() -> None:
    prize, thesis = (asdict(settings("config", f"reward={name}").reward) for name in ("navigation_prize", "navigation"))
    assert (prize.pop("name"), thesis.pop("name")) == ("navigation_prize", "navigation")
    assert thesis.pop("arrived_reward") == 0.0
    assert prize.pop("arrived_reward") == pytest.approx(sum(thesis["weights"][1:]) / (1 - TD3Config().gamma))
    assert prize == thesis


def test_the_dynamic_environment_differs_in_its_planes_only() -> None:
    dynamic, static = asdict(settings("config", "env=dynamic").env), asdict(settings("config").env)
    assert dynamic.pop("name") == "dynamic" and static.pop("name") == "static"
    assert dynamic["world"].pop("planes") == 3 and static["world"].pop("planes") == 0
    assert dynamic == static


def test_the_asynchronous_collector_flies_further_ahead() -> None:
    collector = asdict(settings("config", "collector=async").collector)
    assert collector == {"name": "async", "steps_per_batch": 64, "processes": 1}


def test_the_fast_preset_leaves_the_default_as_it_is_and_can_be_changed_in_turn() -> None:
    plain_run, fast = settings("config"), settings("config", "preset=fast", "algo.n_steps=5", "collector=sync")
    assert (plain_run.algo.n_steps, plain_run.algo.layer_norm, plain_run.algo.exploration_spread) == (1, False, 1.0)
    assert (plain_run.buffer.mirror, plain_run.trainer.until_success) == (False, None)
    assert (fast.algo.n_steps, fast.algo.layer_norm, fast.buffer.mirror) == (5, True, True)
    assert (fast.collector.name, fast.backward_reward.name, fast.reward.name) == ("sync", "abr", "navigation_prize")
    assert settings("config", "preset=fast", "env=dynamic").env.world.planes == 3


@pytest.mark.parametrize(("name", "schema"), [("config", TrainConfig), ("evaluate", EvaluateConfig)])
def test_top_level_yaml_holds_every_field_and_default(name: str, schema: type) -> None:
    written = yaml.safe_load((conf_dir() / f"{name}.yaml").read_text())
    groups = [next(iter(item)) for item in written["defaults"] if isinstance(item, dict)]
    groups = [group for group in groups if not group.startswith(("override", "scheme", "preset", "experiment"))]
    values = {key: value for key, value in written.items() if key not in ("defaults", "hydra")}
    assert set(values) | set(groups) == {field.name for field in fields(schema)}
    defaults = {field.name: field.default for field in fields(schema) if field.name in values}
    if name == "config":
        assert values.pop("run_dir").startswith(f"{defaults.pop('run_dir')}/")
    assert values == defaults


@pytest.mark.parametrize("path", YAML_FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_key_has_a_comment(path: Path) -> None:
    lines = path.read_text().splitlines()
    hydra = next((i for i, line in enumerate(lines) if line.startswith("hydra:")), len(lines))
    bare = [
        line
        for line in lines[:hydra]
        if re.match(r"\s*\w+:", line)
        and "#" not in line
        and not line.startswith("defaults:")
        and not line.startswith(("name:", "world:", "trainer:", "buffer:"))
    ]
    assert not bare


CONSTRUCTORS = [
    (NavigationRewardConfig(), [NavigationReward.__init__]),
    (TraditionalRewardConfig(), [TraditionalReward.__init__]),
    (TD3Config(), [TD3Loss.__init__, ActorCriticStepper.__init__, Actor.__init__, Critic.__init__]),
    (SACConfig(policy_delay=2), [ActorCriticStepper.__init__, GaussianActor.__init__, Critic.__init__]),
    (ABRConfig(), [BackwardReward.__init__, OneShotClassifier.__init__]),
    (ABRPlusConfig(), [BackwardReward.__init__]),
    (
        PerceptionConfig(),
        [TruncatedIcosahedron.__init__, NavigationObservation.__init__, navigation_state, NavigationEnv.__init__],
    ),
    (EnvConfig(), [NavigationEnv.__init__]),
    (BipedalConfig(), [BipedalEnv.__init__]),
    (WalkerRewardConfig(), [WalkerReward.__init__]),
    (FailureBiasedBufferConfig(), [FailureBias.__init__]),
]
COVERED = {  # keys of the dataclass that a constructor takes under the same name
    "navigation": {"weights", "flight_level", "collided_reward", "arrived_reward", "altitude_term"},
    "traditional": {"arrived_reward", "collided_reward"},
    "td3": {
        "gamma",
        "policy_noise",
        "noise_clip",
        "actor_lr",
        "critic_lr",
        "policy_delay",
        "tau",
        "hidden",
        "layer_norm",
    },
    "sac": {"actor_lr", "critic_lr", "temperature_lr", "policy_delay", "tau", "hidden", "layer_norm"},
    "abr": {"multiplier", "threshold", "max_classes", "seed"},
    "abr_plus": {"multiplier"},
    "truncated_icosahedron": {"radius", "statistic", "angles", "frames", "blind", "blind_to"},
    "static": {"num_uavs", "max_steps", "goal_angle"},
    "bipedal_hardcore": {"max_steps"},
    "walker": {"fall_reward", "scale"},
    "failure_biased": {"success_return", "probability", "falls_per_success"},
}


@pytest.mark.parametrize(("config", "functions"), CONSTRUCTORS, ids=lambda value: getattr(value, "name", ""))
def test_constructors_default_to_the_configuration(config: Any, functions: list[Any]) -> None:
    defaults = signature(*functions)
    values = {field.name: getattr(config, field.name) for field in fields(config)}
    shared = {key for key in values if key in defaults and not is_dataclass(values[key])}
    shared = {key for key in shared if key != "name"}
    assert shared == COVERED[config.name]
    assert {key: defaults[key] for key in shared} == {key: values[key] for key in shared}


def test_enhancers_default_to_the_configuration() -> None:
    for config, constructor in ((ForkConfig(), Fork.__init__), (LifeGuardConfig(), LifeGuard.__init__)):
        defaults = signature(constructor)
        shared = {key: value for key, value in asdict(config).items() if key in defaults}
        chosen = {"threshold", "max_reward", "base_weight"}  # measured for the UAV; FORK's depend on its variant
        assert len(shared) >= 5
        assert {k: v for k, v in shared.items() if k not in chosen} == {k: defaults[k] for k in shared.keys() - chosen}
    assert tuple(ForkConfig().system_hidden) == signature(SystemNet.__init__)["hidden"]
    assert tuple(ForkConfig().reward_hidden) == signature(RewardNet.__init__)["hidden"]


def test_ddpg_defaults_agree_where_they_are_not_td3s() -> None:
    assert signature(DDPGLoss.__init__)["gamma"] == DDPGConfig().gamma
    shared = {f.name for f in fields(DDPGConfig)} - {"name", "policy_delay"}
    assert {key: getattr(DDPGConfig(), key) for key in shared} == {key: getattr(TD3Config(), key) for key in shared}


@pytest.mark.parametrize("part", ["world", "airframe", "aerodynamics"])
def test_the_environment_builds_its_parts_by_the_same_defaults(part: str) -> None:
    assert signature(NavigationEnv.__init__)[part] is None  # which the constructor turns into the class's defaults
    default = type(getattr(EnvConfig(), part))()
    assert plain(asdict(getattr(settings("config").env, part))) == plain(asdict(default))


def test_only_the_lidars_range_is_cut_by_the_configuration() -> None:
    assert PerceptionConfig().lidar == LidarConfig(max_range=PerceptionConfig().radius)
    assert settings("config").perception.lidar == LidarConfig(max_range=4.0)


def test_the_lidars_range_follows_the_radius() -> None:
    assert settings("config", "perception.radius=5.5").perception.lidar.max_range == 5.5


def test_beta_of_prioritised_replay_is_the_papers() -> None:
    assert (PrioritizedBufferConfig().alpha, PrioritizedBufferConfig().beta) == (
        0.6,
        0.4,
    )  # Schaul et al. 2015, table 3


def test_logging_asks_for_no_account() -> None:
    assert LoggerConfig().name == "csv" and LoggerConfig().offline


# ---------------------------------------------------------------------- out of range

OUT_OF_RANGE = [
    ("seed", "-1"),
    ("env.num_uavs", "0"),
    ("env.max_steps", "0"),
    ("env.goal_angle", "yaw"),
    ("env.world.seeds", "[]"),
    ("env.world.seeds", "[-1]"),
    ("env.world.size", "[40.0,0.0]"),
    ("env.world.obstacles", "-1"),
    ("env.world.obstacle_scale", "0"),
    ("env.world.flight_level", "-1"),
    ("env.world.ceiling", "-8"),
    ("env.world.goal_radius", "0"),
    ("env.world.min_goal_distance", "-1"),
    ("env.world.min_clearance", "-1"),
    ("env.world.uav_radius", "0"),
    ("env.world.planes", "-3"),
    ("env.world.plane_speed", "[4.0,2.5]"),
    ("env.world.plane_wingspan", "0"),
    ("env.world.plane_keep_out", "-1"),
    ("env.airframe.mass", "0"),
    ("env.airframe.inertia", "[0.0,1.0,1.0]"),
    ("env.airframe.arm", "-1"),
    ("env.airframe.torque_to_thrust", "0"),
    ("env.airframe.max_total_thrust", "10"),
    ("env.airframe.tilt_limit", "2"),
    ("env.airframe.collision_radius", "0"),
    ("env.airframe.collision_height", "-1"),
    ("env.airframe.lidar_diameter", "0"),
    ("env.airframe.lidar_height", "0"),
    ("env.aerodynamics.gust_time_constant", "0"),
    ("perception.frames", "0"),
    ("perception.statistic", "mean"),
    ("perception.angles", "rad"),
    ("perception.blind_to", "rocks"),
    ("perception.lidar.max_range", "0"),
    ("perception.lidar.min_range", "5"),
    ("perception.lidar.range_noise", "-0.1"),
    ("perception.lidar.dropout", "1"),
    ("reward.weights", "[1.0,2.0]"),
    ("reward.flight_level", "0"),
    ("reward.altitude_term", "square"),
    ("reward.name", "traditional"),
    ("algo.name", "ddpg"),
    ("algo.gamma", "1"),
    ("algo.tau", "0"),
    ("algo.batch_size", "0"),
    ("algo.actor_lr", "0"),
    ("algo.critic_lr", "-1"),
    ("algo.policy_delay", "0"),
    ("algo.policy_noise", "-1"),
    ("algo.noise_clip", "-1"),
    ("algo.exploration_noise", "-0.1"),
    ("algo.random_steps", "-1"),
    ("algo.hidden", "[]"),
    ("algo.hidden", "[400,0]"),
    ("buffer.capacity", "0"),
    ("buffer.name", "prioritized"),
    ("collector.steps_per_batch", "0"),
    ("trainer.episodes", "0"),
    ("trainer.updates_per_step", "0"),
    ("trainer.window", "0"),
    ("trainer.checkpoint_interval", "0"),
    ("trainer.keep_checkpoints", "0"),
    ("trainer.threads", "0"),
    ("trainer.execution", "fast"),
    ("trainer.products", "blas"),
    ("logger.name", "mlflow"),
    ("logger.interval", "0"),
]
BACKWARD_OUT_OF_RANGE = [
    ("abr", "multiplier", "-0.2"),
    ("abr", "threshold", "1.1"),
    ("abr", "max_classes", "0"),
    ("abr", "seed", "-1"),
    ("abr_plus", "multiplier", "-0.2"),
]
ENHANCER_OUT_OF_RANGE = [
    ("fork.variant", "walker"),
    ("fork.system_hidden", "[]"),
    ("fork.reward_hidden", "[0]"),
    ("fork.model_lr", "0"),
    ("fork.threshold", "0"),
    ("fork.max_reward", "-1"),
    ("fork.base_weight", "-0.6"),
    ("fork.return_window", "0"),
    ("lifeguard.model", "tree"),
    ("lifeguard.penalty", "none"),
    ("lifeguard.penalty_weight", "-10"),
    ("lifeguard.success_window", "0"),
    ("lifeguard.capacity", "0"),
    ("lifeguard.batch_size", "7"),
    ("lifeguard.min_collisions", "0"),
    ("lifeguard.min_evaluations", "-1"),
    ("lifeguard.evaluation_window", "0"),
    ("lifeguard.min_true_negative_rate", "1"),
    ("lifeguard.model_lr", "0"),
    ("lifeguard.alpha", "0"),
]
NOT_FINITE = ["algo.gamma", "algo.actor_lr", "trainer.updates_per_step", "env.world.ceiling", "env.airframe.mass"]


@pytest.mark.parametrize(("key", "value"), OUT_OF_RANGE, ids=lambda text: text)
def test_values_out_of_range_are_refused_by_name(key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=rf"(?i)\b{key.rpartition('.')[2]}\b"):
        to_dataclass(changed([], f"{key}={value}"))


@pytest.mark.parametrize(("key", "value"), ENHANCER_OUT_OF_RANGE, ids=lambda text: text)
def test_values_of_enhancers_out_of_range_are_refused_by_name(key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=rf"algo\.{re.escape(key)} must be"):
        to_dataclass(changed(["algo=td3_fork_lg"], f"algo.{key}={value}"))


@pytest.mark.parametrize(("name", "key", "value"), BACKWARD_OUT_OF_RANGE)
def test_values_of_the_backward_reward_out_of_range_are_refused_by_name(name: str, key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=rf"backward_reward\.{key} must be"):
        to_dataclass(changed([f"backward_reward={name}"], f"backward_reward.{key}={value}"))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("env.max_steps", "0"),
        ("reward.scale", "0"),
        ("buffer.capacity", "0"),
        ("buffer.probability", "1.5"),
        ("buffer.falls_per_success", "-1"),
        ("buffer.updates_when_left_out", "-1"),
    ],
)
def test_values_of_the_walker_out_of_range_are_refused_by_name(key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=rf"{re.escape(key)} must be"):
        to_dataclass(changed(["env=bipedal_hardcore"], f"{key}={value}"))


@pytest.mark.parametrize("key", ["temperature_lr", "gamma"])
def test_values_of_sac_out_of_range_are_refused_by_name(key: str) -> None:
    with pytest.raises(UavrlError, match=rf"algo\.{key} must be"):
        to_dataclass(changed(["algo=sac"], f"algo.{key}=-1"))


def test_a_radius_out_of_range_is_refused_by_name() -> None:
    with pytest.raises(UavrlError, match=r"perception\.radius must be a length above 0 m"):
        settings("config", "perception.radius=0", "perception.lidar.max_range=4")


@pytest.mark.parametrize(("key", "value"), [("alpha", "1.5"), ("beta", "-0.1")])
def test_exponents_of_prioritised_replay_are_checked(key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=rf"buffer\.{key} must be in \[0, 1\]"):
        to_dataclass(changed(["buffer=prioritized"], f"buffer.{key}={value}"))


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("key", NOT_FINITE)
def test_what_is_no_finite_number_is_refused_by_name(key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=rf"{re.escape(key)} must be a finite number"):
        to_dataclass(changed([], f"{key}={value}"))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("episodes", "0"),
        ("num_uavs", "0"),
        ("threads", "0"),
        ("products", "blas"),
        ("seed", "-1"),
        ("valleys", "[]"),
        ("valleys", "[-1]"),
        ("env.max_steps", "0"),
    ],
)
def test_evaluation_refuses_values_out_of_range_by_name(key: str, value: str) -> None:
    with pytest.raises(UavrlError, match=re.escape(key)):
        to_dataclass(changed([], f"{key}={value}", name="evaluate"))


def test_every_key_that_has_a_most_or_takes_memory_is_one() -> None:
    known = {key for name in ("config", "evaluate", "pretrain", "replay") for key in known_keys(name)}
    everything = settings("config", "algo=td3_fork_lg", "backward_reward=abr")
    assert not {*MOST, *bytes_needed(everything)} - known
    assert not {*LARGEST} - {f.name for f in fields(WorldConfig)}


def test_a_group_left_out_is_refused_by_name() -> None:
    with pytest.raises(UavrlError, match="reward must be one of navigation, navigation_prize, traditional, walker"):
        TrainConfig()


def test_a_missing_value_is_refused_by_name() -> None:
    with pytest.raises(UavrlError, match=r"algo\.gamma"):
        settings("config", "algo.gamma=???")
