"""Typed configuration of replay and of the backward reward on the way there. Meanings and units stand in the yaml."""

from __future__ import annotations

from dataclasses import dataclass

from uavrl.configs.checks import require


@dataclass
class UniformBufferConfig:
    """conf/buffer/uniform.yaml."""

    name: str = "uniform"
    capacity: int = 1_000_000
    mirror: bool = False

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
