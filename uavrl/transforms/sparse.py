"""The reward that tells least: whether a flight arrived."""

from __future__ import annotations

from tensordict import TensorDictBase
from torchrl.envs.transforms import Transform


class SparseReward(Transform):
    """1 for arriving, -1 for colliding and 0 for every other step: what shaped rewards are compared with.

    Args:
        arrived_reward: for arriving.
        collided_reward: for colliding; wins where a step does both.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> after = TensorDict(arrived=torch.tensor([[False], [True]]), collided=torch.tensor([[False], [False]]))
        >>> SparseReward()(TensorDict(next=after))["next", "reward"].squeeze(-1).tolist()
        [0.0, 1.0]
    """

    def __init__(self, arrived_reward: float = 1.0, collided_reward: float = -1.0) -> None:
        super().__init__(in_keys=["arrived", "collided"], out_keys=["reward"])
        self.arrived_reward, self.collided_reward = arrived_reward, collided_reward

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        arrived, collided = (next_tensordict[key] for key in self.in_keys)
        reward = self.arrived_reward * (arrived & ~collided).float() + self.collided_reward * collided.float()
        return next_tensordict.set(self.out_keys[0], reward)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Pays stored transitions."""
        return tensordict.set("next", self._step(tensordict, tensordict["next"]))
