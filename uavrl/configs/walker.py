"""Typed configuration of what the bipedal walker has of its own. Meanings and units stand in the yaml."""

from __future__ import annotations

from dataclasses import dataclass

from uavrl.configs.checks import require


@dataclass
class BipedalConfig:
    """conf/env/bipedal_hardcore.yaml."""

    name: str = "bipedal_hardcore"
    max_steps: int = 2000

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.max_steps >= 1, "env.max_steps", "at least 1", self.max_steps)


@dataclass
class NoPerceptionConfig:
    """conf/perception/none.yaml."""

    name: str = "none"


@dataclass
class WalkerRewardConfig:
    """conf/reward/walker.yaml."""

    name: str = "walker"
    fall_reward: float = -5.0
    scale: float = 5.0

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.scale > 0, "reward.scale", "above 0", self.scale)
