"""Typed configuration of a training, and every group's choices. Meanings and units stand in the yaml."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from uavrl.configs.algo import DDPGConfig, ForkConfig, LifeGuardConfig, SACConfig, TD3Config
from uavrl.configs.buffer import (
    ABRConfig,
    ABRPlusConfig,
    FailureBiasedBufferConfig,
    NoBackwardRewardConfig,
    PrioritizedBufferConfig,
    UniformBufferConfig,
)
from uavrl.configs.checks import require, require_one_of, require_products
from uavrl.configs.valley import EnvConfig, NavigationRewardConfig, PerceptionConfig, TraditionalRewardConfig
from uavrl.configs.walker import BipedalConfig, NoPerceptionConfig, WalkerRewardConfig


@dataclass
class CollectorConfig:
    """conf/collector."""

    name: str = "sync"
    steps_per_batch: int = 16
    processes: int = 1

    def __post_init__(self) -> None:
        """Checks ranges."""
        require_one_of(self.name, "collector.name", ("sync", "async"))
        fitting = self.processes == 1 or (self.name == "async" and self.processes >= 1)
        require(fitting, "collector.processes", "1, or with collector=async more", self.processes)
        require(self.steps_per_batch >= 1, "collector.steps_per_batch", "at least 1", self.steps_per_batch)


@dataclass
class TrainerConfig:
    """conf/trainer."""

    episodes: int = 5000
    until_success: float | None = None
    updates_per_step: float = 1.0
    window: int = 500
    checkpoint_interval: int = 20_000
    keep_checkpoints: int = 2
    threads: int = 1
    execution: str = "auto"
    products: str = "auto"
    record_states: bool = False
    progress: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        require_one_of(self.execution, "trainer.execution", ("eager", "captured", "compiled", "auto"))
        require_products(self.products, "trainer.products")
        for key in ("episodes", "window", "checkpoint_interval", "keep_checkpoints", "threads"):
            require(getattr(self, key) >= 1, f"trainer.{key}", "at least 1", getattr(self, key))
        rate = self.until_success
        require(rate is None or 0 < rate <= 1, "trainer.until_success", "null or a share in (0, 1]", rate)
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
        require(bool(self.run_dir.strip()), "run_dir", "a folder to make", self.run_dir)
        for group in CHOSEN_GROUPS:
            chosen = getattr(self, group)
            names = [name for name, schema in GROUPS[group].items() if schema is type(chosen)]
            require(bool(names), group, f"one of {', '.join(GROUPS[group])}", chosen)
            expected = f"{' or '.join(map(repr, names))} (choose by {group}=NAME)"
            require(chosen.name in names, f"{group}.name", expected, chosen.name)


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
