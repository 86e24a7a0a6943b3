"""Storages of transitions; one keeps stacked frames once."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tensordict
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyTensorStorage

from uavrl.upstream import rows

FIRST = "first_frame"  # the key of the number of an observation's first frame


class GatheringStorage(LazyTensorStorage):
    """TorchRL's storage with random batches by ``index_select``, which takes half the time of ``tensor[index]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> storage = GatheringStorage(10)
        >>> storage.set(torch.arange(3), TensorDict({"reward": torch.tensor([1.0, 2.0, 3.0])}, [3]))
        >>> storage.get(torch.tensor([2, 0]))["reward"]
        tensor([3., 1.])
    """

    def get(self, index: Any) -> Any:
        """The transitions at ``index``, which may be anything that a tensor takes."""
        asks_rows = isinstance(index, Tensor) and index.ndim == 1 and index.dtype == torch.long and len(index) > 0
        holds_rows = self.initialized and isinstance(self._storage, TensorDictBase) and self.ndim == 1
        if not (asks_rows and holds_rows and 0 <= int(index.min()) <= int(index.max()) < len(self)):
            return super().get(index)
        return rows(self._storage, index.to(self.device))

    def column(self, key: NestedKey) -> Tensor:
        """One entry of all transitions, in the order of their places."""
        return self._storage.get(key)[: len(self)]


class FrameStorage(GatheringStorage):
    """Keeps each frame once, and gives back bit by bit the transitions that it was given.

    A state of F stacked frames shares F - 1 of them with the next state, which is again the state of the next
    transition. The storage keeps the run of frames behind them: the F frames of a first state, then one for each
    transition. With ``frames=1`` that is each state once, whatever it is made of. A transition that does not begin
    where the last one ended begins a new run: writes may be whole episodes, single steps of one environment, or steps
    that have nothing to do with each other.

    TorchRL's ``compact_obs`` with :class:`~torchrl.envs.transforms.NextStateReconstructor` drops the next states too,
    but needs the following step in the same batch, and gives NaN at the end of an episode.

    Memory grows as the storage fills, with as many frames as the transitions in it need. Only one process may write.

    Args:
        max_size: transitions.
        frames: F, frames stacked along the last dimension of an observation, oldest first.
        observation: key of the observations, ``[T, F * W]``; that of the next ones is ``("next", observation)``.
        device: of everything stored.

    Raises:
        ValueError: at a write, for observations that are no stack of F frames, each moved up by one. TorchRL's writer
            has then moved on already: empty the buffer before the next write, which is refused too.
        KeyError: at a write, when an observation is missing.

    Examples:
        >>> storage = FrameStorage(10, frames=2)
        >>> states = torch.tensor([[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]])  # of the frames 0, 1, 2, 3
        >>> storage.set(range(2), TensorDict({"observation": states[:2], "next": {"observation": states[1:]}}, [2]))
        >>> storage.get(torch.tensor([1, 0]))["next", "observation"].tolist()
        [[2.0, 3.0], [1.0, 2.0]]
        >>> storage.state_dict()["frames"].tolist()
        [[0.0], [1.0], [2.0], [3.0]]
    """

    def __init__(
        self,
        max_size: int,
        frames: int = 1,
        *,
        observation: NestedKey = "observation",
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(max_size, device=device)
        self.frames = frames
        self.keys = (observation, ("next", observation) if isinstance(observation, str) else ("next", *observation))
        # Frame number i since the beginning is at i % len(ring); those before `_oldest` are needed no more.
        self._ring: Tensor | None = None
        self._oldest = self._end = 0

    def set(self, cursor: Any, data: Any, *, set_cursor: bool = True) -> None:
        """Writes transitions, which must be tensordicts."""
        if isinstance(cursor, int):
            cursor, data = torch.tensor([cursor]), data[None]
        data = torch.stack(data) if isinstance(data, list) else data
        if not isinstance(data, TensorDictBase):
            raise TypeError(f"Expected transitions as a TensorDict, got {type(data).__name__}.")
        if not len(data):
            return
        self._refuse_a_hole(cursor, len(data))
        data = data.to(self.device)
        before, after = (self._unstacked(data, key) for key in self.keys)
        if not _same(before[:, 1:], after[:, :-1]).all():
            raise ValueError(
                f"Expected each next observation to be the observation moved up by one of {self.frames} frames, got "
                f"others: stack them by CatFrames along the last dimension, or store whole states with frames=1."
            )
        starts = torch.ones(len(data), dtype=torch.bool, device=self.device)
        starts[1:] = ~_same(before[1:], after[:-1])
        if self._end:
            last = torch.arange(self._end - self.frames, self._end, device=self.device)
            starts[:1] = ~_same(before[:1], self._frames(last)[None])
        steps = torch.arange(len(data), device=self.device)
        first = self._end + steps + self.frames * (starts.cumsum(0) - 1)
        super().set(cursor, data.exclude(*self.keys).set(FIRST, first), set_cursor=set_cursor)
        end = self._end + len(data) + self.frames * int(starts.sum())
        self._make_room(end, first, before)
        self._write(first[starts], before[starts])
        self._write(first + self.frames, after[:, -1:])
        self._end = end

    def get(self, index: Any) -> Any:
        """The transitions at ``index``, which may be anything that a tensor takes."""
        batch = super().get(index).copy()
        numbers = batch.pop(FIRST)[..., None] + torch.arange(self.frames, device=self.device)
        for step, key in enumerate(self.keys):
            batch.set(key, self._frames(numbers + step).flatten(-2))
        return batch

    def state_dict(self) -> dict[str, Any]:
        """The ``transitions``, the ``frames [n, W]`` that they need, and ``stacked``, F; the last alone if it is empty.

        An observation begins at ``frames[first_frame]``, the next one a row later.
        """
        if not len(self):
            return {"stacked": torch.tensor(self.frames)}
        transitions = super().get(slice(0, len(self))).copy()
        oldest = int(transitions[FIRST].min())
        transitions.set(FIRST, transitions[FIRST] - oldest)
        frames = self._frames(torch.arange(oldest, self._end, device=self.device))
        return {"transitions": transitions, "frames": frames, "stacked": torch.tensor(self.frames)}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Replaces everything by what :meth:`state_dict` gave; ValueError for states of another number of frames."""
        if int(state_dict["stacked"]) != self.frames:
            raise ValueError(f"Expected states of {self.frames} frames, got those of {int(state_dict['stacked'])}.")
        if "transitions" not in state_dict:
            self._empty()
            return
        transitions, frames = (state_dict[key].clone().to(self.device) for key in ("transitions", "frames"))
        self._empty()
        super().set(torch.arange(len(transitions)), transitions)
        self._make_room(len(frames), transitions[FIRST], frames)
        self._write(torch.zeros(1, dtype=torch.long, device=self.device), frames[None])
        self._end = len(frames)

    def dumps(self, path: str | Path) -> None:
        """Writes :meth:`state_dict` below ``path``."""
        tensordict.save(TensorDict(self.state_dict()), path)

    def loads(self, path: str | Path) -> None:
        """Restores what :meth:`dumps` wrote."""
        self.load_state_dict(tensordict.load(path, allow_pickle=False))

    @classmethod
    def saved_at(cls, path: str | Path) -> FrameStorage:
        """A storage just large enough for what :meth:`dumps` wrote, with as many frames to a state."""
        saved = tensordict.load(path, allow_pickle=False)
        storage = cls(max(len(saved.get("transitions", ())), 1), int(saved["stacked"]))
        storage.load_state_dict(saved)
        return storage

    @property
    def frame_bytes(self) -> int:
        """Memory of the frames that are kept."""
        return 0 if self._ring is None else (self._end - self._oldest) * self._ring[0].nbytes

    def _empty(self) -> None:
        super()._empty()
        self._ring = None
        self._oldest = self._end = 0

    def _refuse_a_hole(self, cursor: Any, count: int) -> None:
        """Refuses a write that would leave places between the old and the new ones to which nothing was written."""
        if isinstance(cursor, slice):
            return
        last = int(cursor.max() if isinstance(cursor, Tensor) else max(cursor))
        length = min(len(self) + count, self.max_size)
        if last >= length:
            raise ValueError(
                f"Expected a write to the places below {length}, got place {last}: a write before this one was "
                f"refused. Empty the buffer (buffer.empty()) and write again."
            )

    def _unstacked(self, data: TensorDictBase, key: NestedKey) -> Tensor:
        """The frames ``[T, F, W]`` of an observation."""
        value = data.get(key, None)
        if value is None:
            raise KeyError(f"Expected the key {key!r} in every transition, got {list(data.keys(True, True))}.")
        if value.ndim != 2 or value.shape[-1] % self.frames:
            raise ValueError(
                f"Expected observations [T, {self.frames} * W] of {self.frames} frames, got {list(value.shape)}."
            )
        return value.unflatten(-1, (self.frames, -1))

    def _frames(self, numbers: Tensor) -> Tensor:
        """The frames ``[*B, W]`` with these numbers ``[*B]``."""
        assert self._ring is not None
        return self._ring.index_select(0, numbers.flatten() % len(self._ring)).unflatten(0, numbers.shape)

    def _write(self, first: Tensor, frames: Tensor) -> None:
        """Gives ``frames [T, n, W]`` the numbers from ``first [T]`` on."""
        assert self._ring is not None
        numbers = first[:, None] + torch.arange(frames.shape[1], device=self.device)
        self._ring[numbers % len(self._ring)] = frames

    def _make_room(self, end: int, first: Tensor, like: Tensor) -> None:
        """Makes room for the frames up to number ``end``: first by forgetting, then by a longer ring."""
        if self._ring is None:  # takes memory as it is written to; long enough for episodes of 16 F steps
            self._ring = like.new_empty(max(self.max_size + self.max_size // 16, end), like.shape[-1])
        if end - self._oldest > len(self._ring):
            self._oldest = int(torch.cat([self._storage[FIRST][: len(self)], first]).min())
        if end - self._oldest > len(self._ring):
            numbers = torch.arange(self._oldest, self._end, device=self.device)
            kept = self._frames(numbers)
            self._ring = like.new_empty(max(len(self._ring) * 9 // 8, end - self._oldest), like.shape[-1])
            self._ring[numbers % len(self._ring)] = kept


def _same(one: Tensor, other: Tensor) -> Tensor:
    """Whether frames ``[T, n, W]`` are the same bit by bit, ``[T]``."""
    return (one.contiguous().view(torch.uint8) == other.contiguous().view(torch.uint8)).flatten(1).all(1)
