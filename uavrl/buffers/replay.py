"""Replay buffers of whole episodes, as a run chooses among them."""

from typing import Any

from torchrl.data import PrioritizedSampler, RandomSampler, TensorDictReplayBuffer
from torchrl.data.replay_buffers import Sampler
from torchrl.envs import Transform

from uavrl.buffers.admission import FailureBias
from uavrl.buffers.storage import FrameStorage
from uavrl.ranges import Count, Fraction, Whole


class EpisodeBuffer(TensorDictReplayBuffer):
    """TorchRL's replay buffer on a :class:`FrameStorage`: every stored transition is as likely as the next.

    Args:
        capacity: transitions.
        frames: observations that are stacked in a state; each is stored once.
        transform: what happens to episodes on the way in and to batches on the way out.
        sampler: which transitions are drawn.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> last = torch.tensor([[False], [True]])
        >>> after = {"observation": torch.ones(2, 3), "reward": torch.ones(2, 1), "done": last, "terminated": last}
        >>> buffer = EpisodeBuffer(100)
        >>> _ = buffer.extend(TensorDict({"observation": torch.zeros(2, 3), "next": after}, [2]))
        >>> buffer.sample(5)["observation"].shape
        torch.Size([5, 3])
    """

    admission: FailureBias | None = None
    """What decides which episodes are stored; None stores all."""

    updates_when_left_out = 0
    """Updates of all but actor and targets after an episode that is not stored."""

    reads: tuple[str, ...] = ()
    """What the environment must emit for it."""

    def __init__(
        self,
        capacity: Count = 1_000_000,
        *,
        frames: int = 1,
        transform: Transform | None = None,
        sampler: Sampler | None = None,
    ) -> None:
        super().__init__(
            storage=FrameStorage(capacity, frames, device="cpu"),
            sampler=RandomSampler() if sampler is None else sampler,
            priority_key="td_error",
            transform=transform,
        )


class PrioritizedBuffer(EpisodeBuffer):
    """Prioritised experience replay (Schaul et al. 2015; Chansuparp (2022), Eq. 2.17–2.18).

    Args:
        capacity: transitions.
        alpha: how much the priority counts; 0 is uniform.
        beta: how much importance weights correct for it.
        **kwargs: as in :class:`EpisodeBuffer`.

    Examples:
        >>> PrioritizedBuffer(100).sampler.alpha
        0.6
    """

    def __init__(self, capacity: Count = 1_000_000, alpha: Fraction = 0.6, beta: Fraction = 0.4, **kwargs: Any) -> None:
        super().__init__(capacity, sampler=PrioritizedSampler(capacity, alpha, beta), **kwargs)


class FailureBiasedBuffer(EpisodeBuffer):
    """Keeps most episodes that succeed out (Wei & Ying (2020), their code for the hard-core walker).

    Args:
        capacity: transitions.
        success_return: this and what follows as in :class:`FailureBias`.
        probability: of a success to be stored.
        falls_per_success: that a stored success takes from the counter.
        updates_when_left_out: of all but actor and targets after an episode that is not stored.
        seed: of the coin.
        **kwargs: as in :class:`EpisodeBuffer`.

    Examples:
        >>> FailureBiasedBuffer(100, probability=0.1).admission.probability
        0.1
    """

    reads = ("episode_reward", "collided")

    def __init__(
        self,
        capacity: Count = 1_000_000,
        success_return: float = 250.0,
        probability: Fraction = 0.5,
        falls_per_success: Whole = 10,
        updates_when_left_out: Whole = 100,
        seed: int = 0,
        **kwargs: Any,
    ) -> None:
        super().__init__(capacity, **kwargs)
        self.admission = FailureBias(success_return, probability, falls_per_success, seed)
        self.updates_when_left_out = updates_when_left_out
