"""The replay buffers of whole episodes that a run can choose."""

from typing import Any, Protocol

from tensordict import TensorDictBase
from torchrl.data import PrioritizedSampler, RandomSampler, TensorDictReplayBuffer
from torchrl.data.replay_buffers import Sampler
from torchrl.envs import Transform

from uavrl.buffers.storage import FrameStorage
from uavrl_onboard.ranges import Count, Fraction


class EpisodeFilter(Protocol):
    """Chooses which episodes a buffer stores; its state goes into checkpoints."""

    updates_when_left_out: int
    """How many updates, of all but actor and targets, follow an episode that is not stored."""

    def keeps(self, episode: TensorDictBase) -> bool:
        """Whether one whole episode ``[T]`` is stored; called once for each, with all that the environment emits."""

    def diagnostics(self) -> dict[str, float]:
        """Numbers to log."""

    def state_dict(self) -> dict[str, Any]:
        """The state that :meth:`load_state_dict` restores."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` returned."""


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

    filter: EpisodeFilter | None = None
    """Chooses the episodes that are stored; None stores all."""

    reads: tuple[str, ...] = ()
    """What the environment must emit for the filter."""

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
        alpha: exponent of the priority; 0 is uniform.
        beta: exponent of the importance weights.
        **kwargs: as in :class:`EpisodeBuffer`.

    Examples:
        >>> PrioritizedBuffer(100).sampler.alpha
        0.6
    """

    def __init__(self, capacity: Count = 1_000_000, alpha: Fraction = 0.6, beta: Fraction = 0.4, **kwargs: Any) -> None:
        super().__init__(capacity, sampler=PrioritizedSampler(capacity, alpha, beta), **kwargs)
