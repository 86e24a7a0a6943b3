"""A reward of one's own: a TorchRL transform that writes ``reward``."""

from __future__ import annotations

from tensordict import TensorDictBase
from torchrl.envs import Transform

from uavrl_onboard.ranges import NonNegative, Positive


class HurryReward(Transform):
    """A prize for arriving, as large a punishment for colliding, and every step costs.

    Args:
        prize: for arriving.
        step_cost: of every step.
    """

    def __init__(self, prize: Positive = 10.0, step_cost: NonNegative = 0.1) -> None:
        super().__init__(in_keys=["arrived", "collided"], out_keys=["reward"])
        self.prize, self.step_cost = prize, step_cost

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        arrived, collided = (next_tensordict[key].float() for key in self.in_keys)
        return next_tensordict.set("reward", self.prize * (arrived - collided) - self.step_cost)
