"""MEP-DDPG's replay: a pool of a pilot's transitions, a pool of the learner's own, and the share of the first."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torchrl.data import RandomSampler
from torchrl.data.replay_buffers import Storage

from uavrl.buffers import EpisodeBuffer
from uavrl.errors import UavrlError
from uavrl.transforms.demonstrator import DEMONSTRATOR_ACTION
from uavrl_onboard.ranges import Count, Share


def pilots_share(stored: int, pilot_steps: int, until: int, first_share: float = 1.0) -> float:
    """η: falls linearly from ``first_share``, when the pilot has flown his steps, to 0 after ``until`` steps.

    Examples:
        >>> [pilots_share(stored, 1000, 5000) for stored in (10, 1000, 3000, 5000, 9000)]
        [1.0, 1.0, 0.5, 0.0, 0.0]
    """
    left = (until - stored) / (until - pilot_steps)
    return first_share * min(1.0, max(0.0, left))


def of_pilot(count: int, share: float) -> Tensor:
    """Which of ``count`` transitions in a row are the pilot's ``[count]``: a share of any part of them, to within one.

    Examples:
        >>> of_pilot(6, 0.5).tolist()
        [False, True, False, True, False, True]
    """
    steps = torch.floor(share * torch.arange(count + 1, dtype=torch.float64) + 1e-9)
    return steps[1:] > steps[:-1]


class TwoPools(RandomSampler):
    """Draws a share of each batch from the first ``pilot_steps`` transitions, the rest from those that came later.

    The share follows from how many are stored, so that a resumed run needs no state of it.

    Args:
        pilot_steps, until, first_share: as in :func:`pilots_share`.
    """

    def __init__(self, pilot_steps: int, until: int, first_share: float = 1.0) -> None:
        super().__init__()
        self.pilot_steps, self.until, self.first_share = pilot_steps, until, first_share

    def share(self, stored: int) -> float:
        """The share of the pilot's pool; all of it while the learner's own is empty."""
        return (
            1.0 if stored <= self.pilot_steps else pilots_share(stored, self.pilot_steps, self.until, self.first_share)
        )

    def sample(self, storage: Storage, batch_size: int) -> tuple[Tensor, dict[str, Any]]:
        """Places in the storage ``[batch_size]``."""
        stored = len(storage)
        pilots = min(stored, self.pilot_steps)
        low, count = torch.tensor([pilots, 0]), torch.tensor([stored - pilots, pilots])
        pool = of_pilot(batch_size, self.share(stored)).long()
        drawn = (torch.rand(batch_size, dtype=torch.float64) * count[pool]).long()
        return low[pool] + drawn, {}


class TwoPoolsBuffer(EpisodeBuffer):
    """The two experience pools of MEP-DDPG, in one storage, with uniform sampling in each.

    Source: Hu et al. (2020), Deep Reinforcement Learning Approach with Multiple Experience Pools for UAV's Autonomous
    Motion Planning in Complex Unknown Environments, Sensors 20(7):1890, Algorithm 1: each transition is stored in the
    pool of who chose its action, and a batch is drawn from all pools. By the thesis (Chansuparp 2022, chapter 2) a
    parameter η, the pilots' share, is 1 at first, decreases at each step, and is 0 around the second half of training,
    which is then DDPG. The paper's equation for η was not at hand: here it falls linearly.

    What differs from the paper:

    - The pilot is a scripted controller, ``demonstrator=vfh``, in place of people and of MPC with simulated annealing.
    - He flies the first steps and no later ones; the paper draws at each step who acts, with a probability.
    - The pools part at a number of stored steps. Episodes that were under way when the pilot handed over are put by
      the order in which they ended: at most one of each vehicle is in the other pool, or in both.
    - With η = 0 only the learner's own pool is drawn from.

    Args:
        capacity: transitions; no smaller than ``until``, since the oldest, which are dropped first, are the pilot's.
        pilot_steps: steps that the pilot flies: ``algo.learning_starts``.
        until: stored steps after which nothing of the pilot's is drawn: half of the training's.
        first_share: η at first.
        **kwargs: as in :class:`uavrl.buffers.EpisodeBuffer`.

    Raises:
        UavrlError: for an ``until`` that is not above ``pilot_steps``, or is above ``capacity``.
    """

    reads = (DEMONSTRATOR_ACTION,)  # without a demonstrator the first steps are nobody's

    def __init__(
        self, capacity: Count = 1_000_000, pilot_steps: Count = 10_000, until: Count = 50_000, first_share: Share = 1.0,
        **kwargs: Any,
    ) -> None:  # fmt: skip
        if not pilot_steps < until <= capacity:
            raise UavrlError(
                f"until must be above pilot_steps, {pilot_steps}, and no more than capacity, {capacity}, got {until}: "
                f"write half of the training's steps."
            )
        super().__init__(capacity, sampler=TwoPools(pilot_steps, until, first_share), **kwargs)
