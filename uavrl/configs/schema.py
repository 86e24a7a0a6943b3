"""Typed configuration: one dataclass per yaml file of ``conf/``. Meanings and units stand in the yaml."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from uavrl.configs.checks import require, require_one_of, require_widths
from uavrl.configs.walker import BipedalConfig, NoPerceptionConfig, WalkerRewardConfig
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.quadrotor import Aerodynamics, Airframe
from uavrl.envs.world import WorldConfig


@dataclass
class EnvConfig:
    """conf/env: the task."""

    name: str = "static"
    num_uavs: int = 8
    max_steps: int = 300
    goal_angle: str = "elevation"
    world: WorldConfig = field(default_factory=WorldConfig)
    airframe: Airframe = field(default_factory=Airframe)
    aerodynamics: Aerodynamics = field(default_factory=Aerodynamics)

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.num_uavs >= 1, "env.num_uavs", "at least 1", self.num_uavs)
        require(self.max_steps >= 1, "env.max_steps", "at least 1", self.max_steps)
        require_one_of(self.goal_angle, "env.goal_angle", ("elevation", "course"))
        for key in ("collision_radius", "collision_height", "lidar_diameter", "lidar_height", "torque_to_thrust"):
            require(getattr(self.airframe, key) > 0, f"env.airframe.{key}", "above 0", getattr(self.airframe, key))
        tilt = self.airframe.tilt_limit
        require(0 < tilt < math.pi / 2, "env.airframe.tilt_limit", "an angle in (0, π/2) rad", tilt)


@dataclass
class PerceptionConfig:
    """conf/perception: LiDAR, reduction, scaling and frames."""

    name: str = "truncated_icosahedron"
    radius: float = 4.0
    statistic: str = "face"
    angles: str = "folded"
    frames: int = 3
    lidar: LidarConfig = field(default_factory=lambda: LidarConfig(max_range=4.0))

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.radius > 0, "perception.radius", "a length above 0 m", self.radius)
        require(self.frames >= 1, "perception.frames", "at least 1", self.frames)
        require_one_of(self.statistic, "perception.statistic", ("face", "range"))
        require_one_of(self.angles, "perception.angles", ("folded", "raw"))


@dataclass
class TraditionalRewardConfig:
    """conf/reward/traditional.yaml."""

    name: str = "traditional"
    arrived_reward: float = 50.0
    collided_reward: float = -50.0


@dataclass
class NavigationRewardConfig:
    """conf/reward/navigation.yaml and navigation_prize.yaml."""

    name: str = "navigation"
    weights: tuple[float, ...] = (8.0, 1.0, 0.5, 0.5)
    flight_level: float = 3.5
    collided_reward: float = -50.0
    arrived_reward: float = 0.0
    altitude_term: str = "absolute"

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(len(self.weights) == 4, "reward.weights", "four numbers w_1 to w_4", list(self.weights))
        require(self.flight_level > 0, "reward.flight_level", "a height above 0 m", self.flight_level)
        require_one_of(self.altitude_term, "reward.altitude_term", ("absolute", "literal"))


@dataclass
class ForkConfig:
    """conf/enhancer/fork.yaml and fork_walker.yaml."""

    variant: str = "fork"
    system_hidden: tuple[int, ...] = (400, 300)
    reward_hidden: tuple[int, ...] = (256, 256)
    model_lr: float = 3e-4
    threshold: float = 0.001
    max_reward: float = 460.0
    base_weight: float = 0.6
    return_window: int = 100
    backprop_through_model: bool = False

    def __post_init__(self) -> None:
        """Checks ranges."""
        require_one_of(self.variant, "algo.fork.variant", ("fork", "bipedal"))
        require_widths(self.system_hidden, "algo.fork.system_hidden")
        require_widths(self.reward_hidden, "algo.fork.reward_hidden")
        for key in ("model_lr", "threshold", "max_reward"):
            require(getattr(self, key) > 0, f"algo.fork.{key}", "above 0", getattr(self, key))
        require(self.base_weight >= 0, "algo.fork.base_weight", "at least 0", self.base_weight)
        require(self.return_window >= 1, "algo.fork.return_window", "at least 1", self.return_window)


@dataclass
class LifeGuardConfig:
    """conf/enhancer/lifeguard.yaml."""

    model: str = "linear"
    penalty: str = "probability"
    penalty_weight: float = 10.0
    success_window: int = 100
    capacity: int = 10_000
    batch_size: int = 100
    min_collisions: int = 50
    min_evaluations: int = 20
    evaluation_window: int = 100
    min_true_negative_rate: float = 0.96
    model_lr: float = 1e-3
    alpha: float = 1e-4

    def __post_init__(self) -> None:
        """Checks ranges."""
        require_one_of(self.model, "algo.lifeguard.model", ("linear", "mlp"))
        require_one_of(self.penalty, "algo.lifeguard.penalty", ("probability", "label"))
        require(self.penalty_weight >= 0, "algo.lifeguard.penalty_weight", "at least 0", self.penalty_weight)
        for key in ("success_window", "capacity", "min_collisions", "evaluation_window"):
            require(getattr(self, key) >= 1, f"algo.lifeguard.{key}", "at least 1", getattr(self, key))
        require(self.min_evaluations >= 0, "algo.lifeguard.min_evaluations", "at least 0", self.min_evaluations)
        even = self.batch_size >= 2 and self.batch_size % 2 == 0
        require(even, "algo.lifeguard.batch_size", "an even number from 2", self.batch_size)
        rate = self.min_true_negative_rate
        require(0 <= rate < 1, "algo.lifeguard.min_true_negative_rate", "in [0, 1)", rate)
        for key in ("model_lr", "alpha"):
            require(getattr(self, key) > 0, f"algo.lifeguard.{key}", "above 0", getattr(self, key))


@dataclass
class DDPGConfig:
    """conf/algo/ddpg.yaml."""

    name: str = "ddpg"
    gamma: float = 0.99
    tau: float = 0.005
    batch_size: int = 100
    actor_lr: float = 1e-4
    critic_lr: float = 1e-3
    policy_delay: int = 1
    exploration_noise: float = 0.1
    random_steps: int = 10_000
    hidden: tuple[int, ...] = (400, 300)
    fork: ForkConfig | None = None
    lifeguard: LifeGuardConfig | None = None

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(0 <= self.gamma < 1, "algo.gamma", "in [0, 1)", self.gamma)
        require(0 < self.tau <= 1, "algo.tau", "in (0, 1]", self.tau)
        for key in ("actor_lr", "critic_lr"):
            require(getattr(self, key) > 0, f"algo.{key}", "above 0", getattr(self, key))
        for key in ("batch_size", "policy_delay"):
            require(getattr(self, key) >= 1, f"algo.{key}", "at least 1", getattr(self, key))
        require(self.exploration_noise >= 0, "algo.exploration_noise", "at least 0", self.exploration_noise)
        require(self.random_steps >= 0, "algo.random_steps", "at least 0", self.random_steps)
        require_widths(self.hidden, "algo.hidden")


@dataclass
class TD3Config(DDPGConfig):
    """conf/algo/td3.yaml."""

    name: str = "td3"
    policy_delay: int = 2
    policy_noise: float = 0.2
    noise_clip: float = 0.5

    def __post_init__(self) -> None:
        """Checks ranges."""
        super().__post_init__()
        require(self.policy_noise >= 0, "algo.policy_noise", "at least 0", self.policy_noise)
        require(self.noise_clip >= 0, "algo.noise_clip", "at least 0", self.noise_clip)


@dataclass
class SACConfig(DDPGConfig):
    """conf/algo/sac.yaml."""

    name: str = "sac"
    temperature_lr: float = 3e-4
    target_entropy: float | None = None
    exploration_noise: float = 0.0

    def __post_init__(self) -> None:
        """Checks ranges."""
        super().__post_init__()
        require(self.temperature_lr > 0, "algo.temperature_lr", "above 0", self.temperature_lr)


@dataclass
class UniformBufferConfig:
    """conf/buffer/uniform.yaml."""

    name: str = "uniform"
    capacity: int = 1_000_000

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.capacity >= 1, "buffer.capacity", "at least 1", self.capacity)


@dataclass
class PrioritizedBufferConfig(UniformBufferConfig):
    """conf/buffer/prioritized.yaml."""

    name: str = "prioritized"
    alpha: float = 0.6
    beta: float = 0.4

    def __post_init__(self) -> None:
        """Checks ranges."""
        super().__post_init__()
        require(0 <= self.alpha <= 1, "buffer.alpha", "in [0, 1]", self.alpha)
        require(0 <= self.beta <= 1, "buffer.beta", "in [0, 1]", self.beta)


@dataclass
class FailureBiasedBufferConfig(UniformBufferConfig):
    """conf/buffer/failure_biased.yaml."""

    name: str = "failure_biased"
    success_return: float = 250.0
    probability: float = 0.5
    falls_per_success: int = 10
    updates_when_left_out: int = 100

    def __post_init__(self) -> None:
        """Checks ranges."""
        super().__post_init__()
        require(0 <= self.probability <= 1, "buffer.probability", "in [0, 1]", self.probability)
        for key in ("falls_per_success", "updates_when_left_out"):
            require(getattr(self, key) >= 0, f"buffer.{key}", "at least 0", getattr(self, key))


@dataclass
class NoBackwardRewardConfig:
    """conf/backward_reward/none.yaml."""

    name: str = "none"


@dataclass
class ABRConfig:
    """conf/backward_reward/abr.yaml."""

    name: str = "abr"
    multiplier: float = 0.2
    threshold: float = 0.98
    max_classes: int = 20_000
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.multiplier >= 0, "backward_reward.multiplier", "at least 0", self.multiplier)
        require(0 < self.threshold <= 1, "backward_reward.threshold", "in (0, 1]", self.threshold)
        require(self.max_classes >= 1, "backward_reward.max_classes", "at least 1", self.max_classes)
        require(self.seed >= 0, "backward_reward.seed", "at least 0", self.seed)


@dataclass
class ABRPlusConfig:
    """conf/backward_reward/abr_plus.yaml."""

    name: str = "abr_plus"
    multiplier: float = 0.2
    artifact: str = "packaged"

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.multiplier >= 0, "backward_reward.multiplier", "at least 0", self.multiplier)


@dataclass
class CollectorConfig:
    """conf/collector."""

    name: str = "sync"
    steps_per_batch: int = 16

    def __post_init__(self) -> None:
        """Checks ranges."""
        require_one_of(self.name, "collector.name", ("sync", "async"))
        require(self.steps_per_batch >= 1, "collector.steps_per_batch", "at least 1", self.steps_per_batch)


@dataclass
class TrainerConfig:
    """conf/trainer."""

    episodes: int = 5000
    updates_per_step: float = 1.0
    window: int = 500
    checkpoint_interval: int = 20_000
    keep_checkpoints: int = 2
    threads: int = 1
    execution: str = "auto"
    record_states: bool = False
    progress: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        require_one_of(self.execution, "trainer.execution", ("eager", "captured", "compiled", "auto"))
        for key in ("episodes", "window", "checkpoint_interval", "keep_checkpoints", "threads"):
            require(getattr(self, key) >= 1, f"trainer.{key}", "at least 1", getattr(self, key))
        require(self.updates_per_step > 0, "trainer.updates_per_step", "above 0", self.updates_per_step)


@dataclass
class LoggerConfig:
    """conf/logger."""

    name: str = "csv"
    interval: int = 1000
    project: str = "uavrl"
    offline: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        require_one_of(self.name, "logger.name", ("csv", "tensorboard", "wandb"))
        require(self.interval >= 1, "logger.interval", "at least 1", self.interval)


@dataclass
class TrainConfig:
    """conf/config.yaml: one training run."""

    env: Any = None
    perception: Any = None
    reward: Any = None
    algo: Any = None
    buffer: Any = None
    backward_reward: Any = None
    collector: CollectorConfig = field(default_factory=CollectorConfig)
    trainer: TrainerConfig = field(default_factory=TrainerConfig)
    logger: LoggerConfig = field(default_factory=LoggerConfig)
    seed: int = 0
    device: str = "cpu"
    run_dir: str = "runs"
    resume: str | None = None

    def __post_init__(self) -> None:
        """Checks ranges, and that each group's name is its own: reports and resumed runs go by it."""
        require(0 <= self.seed < 2**31, "seed", "in [0, 2**31)", self.seed)
        for group in CHOSEN_GROUPS:
            chosen = getattr(self, group)
            names = [name for name, schema in GROUPS[group].items() if schema is type(chosen)]
            require(bool(names), group, f"one of {', '.join(GROUPS[group])}", chosen)
            expected = f"{' or '.join(map(repr, names))} (choose by {group}=NAME)"
            require(chosen.name in names, f"{group}.name", expected, chosen.name)


@dataclass
class EvaluateConfig:
    """conf/evaluate.yaml: one evaluation."""

    run: str | None = None
    policy: str | None = None
    env: Any = None
    perception: Any = None
    episodes: int = 500
    seed: int = 20_000
    valleys: tuple[int, ...] | None = None
    checkpoint: str | None = None
    output: str | None = None
    num_uavs: int = 8
    device: str = "cpu"
    threads: int = 1
    progress: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        for key in ("episodes", "num_uavs", "threads"):
            require(getattr(self, key) >= 1, key, "at least 1", getattr(self, key))
        seeds = self.valleys
        require(
            seeds is None or (len(seeds) > 0 and min(seeds) >= 0), "valleys", "null or a list of seeds from 0", seeds
        )
        require(0 <= self.seed < 2**31, "seed", "in [0, 2**31)", self.seed)


GROUPS: dict[str, dict[str, type]] = {
    "env": {"static": EnvConfig, "dynamic": EnvConfig, "bipedal_hardcore": BipedalConfig},
    "perception": {"truncated_icosahedron": PerceptionConfig, "none": NoPerceptionConfig},
    "reward": {
        "navigation": NavigationRewardConfig,
        "navigation_prize": NavigationRewardConfig,
        "traditional": TraditionalRewardConfig,
        "walker": WalkerRewardConfig,
    },
    "algo": {
        "td3": TD3Config,
        "td3_fork": TD3Config,
        "td3_lg": TD3Config,
        "td3_fork_lg": TD3Config,
        "td3_walker": TD3Config,
        "td3_fork_walker": TD3Config,
        "td3_lg_walker": TD3Config,
        "ddpg": DDPGConfig,
        "ddpg_lg": DDPGConfig,
        "sac": SACConfig,
        "sac_lg": SACConfig,
    },
    "enhancer": {"fork": ForkConfig, "fork_walker": ForkConfig, "lifeguard": LifeGuardConfig},
    "buffer": {
        "uniform": UniformBufferConfig,
        "prioritized": PrioritizedBufferConfig,
        "failure_biased": FailureBiasedBufferConfig,
    },
    "backward_reward": {"none": NoBackwardRewardConfig, "abr": ABRConfig, "abr_plus": ABRPlusConfig},
    "collector": {"sync": CollectorConfig, "async": CollectorConfig},
    "trainer": {"default": TrainerConfig},
    "logger": {"csv": LoggerConfig, "tensorboard": LoggerConfig, "wandb": LoggerConfig},
}

# The groups whose choices have dataclasses of their own.
CHOSEN_GROUPS = ("reward", "algo", "buffer", "backward_reward", "env", "perception")
