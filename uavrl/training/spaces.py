"""What the networks of a run read and write."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torchrl.data import Bounded

from uavrl.configs.walker import BipedalConfig
from uavrl.envs import bipedal
from uavrl.envs.navigation import ACTION_LIMIT

FACES, GOAL_NUMBERS = 32, 3  # of the reduced scan; altitude and two angles


@dataclass(frozen=True)
class Spaces:
    """Widths of observation and action.

    Attributes:
        observation: numbers in one observation.
        frames: observations in a state.
        actions: numbers in an action.
        limit: the largest action; the smallest is its negative.
    """

    observation: int
    frames: int
    actions: int
    limit: float

    @property
    def state(self) -> int:
        """Numbers in the policy's state."""
        return self.frames * self.observation

    def action_spec(self, device: torch.device | str) -> Bounded:
        """The bounds of one action."""
        return Bounded(-self.limit, self.limit, (self.actions,), device=device)


def make_spaces(env: Any, perception: Any) -> Spaces:
    """The spaces of a configured environment.

    Examples:
        >>> from uavrl.configs.valley import EnvConfig, PerceptionConfig
        >>> make_spaces(EnvConfig(), PerceptionConfig())
        Spaces(observation=35, frames=3, actions=4, limit=2.0)
    """
    if isinstance(env, BipedalConfig):
        return Spaces(bipedal.OBSERVATIONS, 1, bipedal.ACTIONS, bipedal.ACTION_LIMIT)
    return Spaces(FACES + GOAL_NUMBERS, perception.frames, 4, ACTION_LIMIT)
