"""The replay buffer of a run, as the loop uses it."""

from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDictBase

from uavrl.buffers import EpisodeBuffer, Windows
from uavrl.buffers.sequences import numbered
from uavrl.runs.episodes import split_episodes
from uavrl.transforms.demonstrator import DEMONSTRATOR_ACTION
from uavrl.transforms.privileged import PRIVILEGED

# What is learned from, beside a demonstrator's actions; everything else that the environment emits is for metrics.
STORED_KEYS = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
    ("next", "arrived"),
    ("next", "collided"),
)
BATCHES_AT_ONCE = 32  # drawn in one call, where every transition is as likely as the next


class EpisodeReplay:
    """Stores whole episodes and gives the batches to learn from: after an episode of T steps T of them."""

    def __init__(
        self,
        buffer: EpisodeBuffer,
        batch_size: int,
        updates_per_step: float = 1.0,
        windows: Windows | None = None,
    ) -> None:
        self.buffer = buffer
        self.windows = windows
        self.stored_episodes = 0
        self.batch_size = batch_size
        self.updates_per_step = updates_per_step
        self.prioritized = hasattr(buffer.sampler, "alpha")
        self.filter = buffer.filter
        self._owed = 0.0

    def filtered(self, episodes: TensorDictBase) -> TensorDictBase:
        """What is stored of whole episodes ``[T]``: those that the buffer's filter keeps, with what is learned from."""
        if self.filter is not None:
            kept = [episode for episode in split_episodes(episodes) if self.filter.keeps(episode)]
            episodes = torch.cat(kept) if kept else episodes[:0]
        optional = (DEMONSTRATOR_ACTION, PRIVILEGED, ("next", PRIVILEGED))
        return episodes.select(*STORED_KEYS, *(key for key in optional if key in episodes.keys(True)))

    def store(self, episodes: TensorDictBase) -> int:
        """Writes whole episodes ``[T]`` and says how many updates follow; also after one that is left out."""
        if len(episodes):
            if self.windows is not None:
                episodes, self.stored_episodes = numbered(episodes, self.stored_episodes)
            self.buffer.extend(episodes)
            self._owed += len(episodes) * self.updates_per_step
        elif self.filter is not None and len(self.buffer):
            self._owed += self.filter.updates_when_left_out
        updates = int(self._owed)
        self._owed -= updates
        return updates

    def batches(self, count: int, size: int | None = None) -> Iterator[TensorDictBase]:
        """``count`` batches of random transitions; a prioritised buffer draws each when the one before is learned.

        For networks with a memory they are windows of episodes, as many as make ``size`` transitions.
        """
        size = self.batch_size if size is None else size
        if self.windows is not None:
            yield from (self.windows.draw(self.buffer, max(size // self.windows.length, 1)) for _ in range(count))
            return
        at_once = 1 if self.prioritized else BATCHES_AT_ONCE
        for done in range(0, count, at_once):
            drawn = self.buffer.sample(min(at_once, count - done) * size)
            yield from [drawn] if self.prioritized else drawn.split(size)

    def draw(self, count: int) -> TensorDictBase:
        """``count`` transitions, each as likely as the next whatever the sampler."""
        return self.buffer[torch.randint(len(self.buffer), (count,))]

    def update_priority(self, batch: TensorDictBase) -> None:
        """Hands the new priorities to a prioritised sampler."""
        if self.prioritized:
            self.buffer.update_tensordict_priority(batch)

    def diagnostics(self) -> dict[str, float]:
        """What the buffer's filter says."""
        return {} if self.filter is None else self.filter.diagnostics()

    def state_dict(self) -> dict[str, Any]:
        """The fraction of an update still owed, and the state of the buffer's filter."""
        own = {"owed": self._owed} | ({} if self.windows is None else {"stored_episodes": self.stored_episodes})
        return own | ({} if self.filter is None else {"filter": self.filter.state_dict()})

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self._owed = state_dict["owed"]
        self.stored_episodes = state_dict.get("stored_episodes", 0)
        if self.filter is not None:
            self.filter.load_state_dict(state_dict["filter"])
