"""Windows of whole episodes from an :class:`~uavrl.buffers.EpisodeBuffer`, for networks with a memory."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from uavrl.buffers.replay import EpisodeBuffer
from uavrl.errors import UavrlError

EPISODE = "episode"  # the key of an episode's number and a step's number in it, by which steps are found in a buffer
WEIGHT = "priority_weight"  # the losses' key of a step's weight


class Window(NamedTuple):
    """Where the steps of B windows are."""

    places: Tensor  #: ``[B, W]`` in the buffer; behind its last step a window repeats that
    filled: Tensor  #: ``bool [B, W]``, false for these repetitions
    steps: Tensor  #: ``[B, T]``, which of the W are learned from; beyond the episode's ends it repeats others
    learned: Tensor  #: ``bool [B, T]``, false for these


def find_windows(episodes: Tensor, anchor: Tensor, first: Tensor, before: int, length: int, after: int) -> Window:
    """Find windows of ``length`` steps to learn from, with ``before`` and ``after`` more, each within one episode.

    Args:
        episodes: ``[P, 2]``, the number of the episode at each place of a buffer, and of the step in it. An episode's
            steps are next to each other, and the last place is before the first one.
        anchor: ``[B]``, a place in each window.
        first: ``[B]``, the place of its first step to learn from; it may be beyond the episode.
        before: steps before that.
        length: T.
        after: steps behind the last one to learn from.

    Examples:
        >>> episodes = torch.tensor([[4, 0], [4, 1], [4, 2], [5, 0]])
        >>> one = find_windows(episodes, torch.tensor([1]), torch.tensor([1]), 2, 2, 1)
        >>> one.places.tolist(), one.filled.tolist()
        ([[0, 1, 2, 2, 2]], [[True, True, True, False, False]])
        >>> one.steps.tolist(), one.learned.tolist()
        ([[1, 2]], [[True, True]])
    """
    size, width = len(episodes), before + length + after
    at = (first - before)[:, None] + torch.arange(width)
    ahead = episodes[at % size] - episodes[anchor][:, None]
    same = (ahead[..., 0] == 0) & (ahead[..., 1] == at - anchor[:, None])
    begin, count = same.int().argmax(1, keepdim=True), same.sum(1, keepdim=True)
    along = torch.arange(width).expand(len(at), -1)
    places = (at[:, :1] + begin + torch.minimum(along, count - 1)) % size
    steps = before + torch.arange(length) - begin
    last = count - 1
    return Window(places, along < count, torch.minimum(steps.clamp(min=0), last), (steps >= 0) & (steps <= last))


@dataclass(frozen=True)
class Windows:
    """Draws windows so that each step of all episodes counts as much as the next.

    Attributes:
        burn_in: steps that only fill the memory.
        length: steps that are learned from.
        n_steps: steps that the next state of a transition is ahead.
    """

    burn_in: int
    length: int
    n_steps: int = 1

    def draw(self, buffer: EpisodeBuffer, count: int) -> TensorDict:
        """Return ``count`` windows ``[B]``.

        Returns:
            ``seen [B, W, S]``, the observations of each window with the one that its episode ended with; and ``steps``,
            the transitions ``[B, T]`` that are learned from, with the places ``now`` and ``then`` of their states in
            ``seen`` and with their weights. A window that an episode's end cuts short repeats transitions that weigh
            nothing, and the others weigh more: a step at an end lies in fewer windows.
        """
        if not isinstance(buffer, EpisodeBuffer):
            raise UavrlError(f"Windows draws from an EpisodeBuffer of uavrl, got a {type(buffer).__name__}.")
        episodes = buffer.storage.column(EPISODE)
        anchor = torch.randint(len(episodes), (count,))
        first = anchor - torch.randint(self.length, (count,))
        window = find_windows(episodes, anchor, first, self.burn_in, self.length, self.n_steps)
        drawn: TensorDictBase = buffer[window.places]
        device = drawn["observation"].device
        steps, learned = window.steps.to(device), window.learned.to(device)
        filled = window.filled.to(device)[..., None]
        seen = torch.where(filled, drawn["observation"], drawn["next", "observation"])
        taken = drawn[torch.arange(count, device=device)[:, None], steps]
        ahead = taken["steps_to_next_obs"].squeeze(-1) if self.n_steps > 1 else 1
        taken.set("now", steps).set("then", (steps + ahead).clamp(max=seen.shape[1] - 1))
        taken.set(WEIGHT, learned / learned.sum(1, keepdim=True))
        return TensorDict({"seen": seen, "steps": taken}, [count])


def numbered(episodes: TensorDictBase, first: int) -> tuple[TensorDictBase, int]:
    """Write :data:`EPISODE` to whole episodes ``[T]``, end to end; return them and the next episode's number.

    Examples:
        >>> done = torch.tensor([[False], [True], [True]])
        >>> numbered(TensorDict({"next": {"done": done}}, [3]), 7)[0]["episode"].tolist()
        [[7, 0], [7, 1], [8, 0]]
    """
    done = episodes["next", "done"].flatten().cpu()
    ends = done.nonzero().flatten().tolist()
    lengths = [end - begin for begin, end in pairwise([-1, *ends])]
    rows = [(first + number, step) for number, length in enumerate(lengths) for step in range(length)]
    return episodes.copy().set(EPISODE, torch.tensor(rows).reshape(-1, 2)), first + len(ends)
