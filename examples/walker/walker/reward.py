"""The rewards by which FORK's authors teach the hard-core bipedal walker."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.envs import Transform

from uavrl_onboard.ranges import Positive


class WalkerReward(Transform):
    """A fall costs little, every other reward counts more (Chansuparp (2022), §4.5; Wei & Ying (2020), their code).

    Args:
        fall_reward: what a fall gives instead of -100.
        scale: factor on every other reward.
    """

    def __init__(self, fall_reward: float = -5.0, scale: Positive = 5.0) -> None:
        super().__init__(in_keys=["reward", "collided"], out_keys=["reward"])
        self.fall_reward, self.scale = fall_reward, scale

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        reward, fell = (next_tensordict[key] for key in self.in_keys)
        return next_tensordict.set("reward", torch.where(fell, self.fall_reward, self.scale * reward))
