"""Typed configuration of the learners and their enhancers. Meanings and units stand in the yaml."""

from __future__ import annotations

from dataclasses import dataclass

from uavrl.configs.checks import require, require_one_of, require_widths


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
    exploration_spread: float = 1.0
    hidden: tuple[int, ...] = (400, 300)
    layer_norm: bool = False
    n_steps: int = 1
    fork: ForkConfig | None = None
    lifeguard: LifeGuardConfig | None = None

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(0 <= self.gamma < 1, "algo.gamma", "in [0, 1)", self.gamma)
        require(0 < self.tau <= 1, "algo.tau", "in (0, 1]", self.tau)
        for key in ("actor_lr", "critic_lr"):
            require(getattr(self, key) > 0, f"algo.{key}", "above 0", getattr(self, key))
        for key in ("batch_size", "policy_delay", "exploration_spread", "n_steps"):
            require(getattr(self, key) >= 1, f"algo.{key}", "at least 1", getattr(self, key))
        one_step = self.fork is None and self.lifeguard is None
        require(
            self.n_steps == 1 or one_step,
            "algo.n_steps",
            "1 with FORK or LifeGuard: they learn from single steps",
            self.n_steps,
        )
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
