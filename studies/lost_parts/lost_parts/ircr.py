"""A rule of others that the backward rewards were compared with: the same data path without classes."""

import torch
from torch import Tensor

from uavrl.buffers.backward_reward import BackwardReward, episode_bounds
from uavrl_onboard.ranges import NonNegative


class IRCR(BackwardReward):
    """Pays each step of a flight that arrived the flight's return, scaled to [0, 1] by the returns seen so far.

    Iterative relative credit refinement (Gangwani et al. (2020), arXiv:2010.12718) spreads a trajectory's scaled return
    over its steps in place of their rewards. Here, as in ABR, it comes on top, and for flights that arrived.

    Args:
        multiplier: what the scaled return is multiplied by.

    Examples:
        >>> ircr = IRCR()
        >>> arrived = done = torch.tensor([False, True, False, True])
        >>> ircr.relabel(torch.zeros(4, 1), torch.tensor([1.0, 2.0, 0.0, 1.0]), arrived, done).tolist()
        [1.0, 2.0, 0.0, 1.0]
        >>> ircr.relabel(torch.zeros(4, 1), torch.tensor([1.0, 2.0, 1.0, 1.0]), arrived, done).tolist()
        [2.0, 3.0, 1.5, 1.5]
    """

    def __init__(self, multiplier: NonNegative = 1.0) -> None:
        super().__init__(_one_class, multiplier=multiplier)
        self.register_buffer("returns", torch.tensor([torch.inf, -torch.inf], dtype=torch.float64))

    returns: Tensor  # the lowest and the highest so far

    def relabel(self, states: Tensor, reward: Tensor, arrived: Tensor, done: Tensor) -> Tensor:
        """New rewards ``[T]`` of whole episodes."""
        new = reward.clone()
        for start, end in episode_bounds(done):
            total = reward[start:end].double().sum()
            low, high = torch.minimum(self.returns[0], total), torch.maximum(self.returns[1], total)
            self.returns.copy_(torch.stack([low, high]))
            if arrived[end - 1] and high > low:
                self.mean_extra = self.multiplier * float((total - low) / (high - low))
                new[start:end] += self.mean_extra
                self.episodes += 1
        return new


def _one_class(states: Tensor) -> Tensor:
    return torch.zeros(len(states), dtype=torch.int64)
