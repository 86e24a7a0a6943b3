"""The reward that tells least: whether a flight arrived."""

from tensordict import TensorDictBase
from torch import Tensor

from uavrl.transforms.rewards import SumOfTerms


class SparseReward(SumOfTerms):
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

    def terms(self, before: TensorDictBase, after: TensorDictBase) -> dict[str, Tensor]:
        """What arriving and colliding give."""
        arrived, collided = (self._get(after, key) for key in self.in_keys)
        return {
            "arrival": self.arrived_reward * (arrived & ~collided).float(),
            "collision": self.collided_reward * collided.float() + 0.0,  # no negative zeros
        }
