"""The transitions that a run has flown: out of its newest checkpoint, or out of a data set on its own."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import tensordict
import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.checkpoint import Checkpoint
from torchrl.data import ImmutableDatasetWriter, Storage, TensorDictReplayBuffer, TensorStorage

from uavrl.buffers import FrameStorage
from uavrl.buffers.sequences import EPISODE
from uavrl.errors import UavrlError
from uavrl.runs.checkpoint import BufferState, check_checkpoint, checkpoint_path, restore
from uavrl.runs.config import read_config
from uavrl.runs.names import CHECKPOINTS, CONFIG
from uavrl.runs.trust import check_links, check_tensors

DATA, STORAGE = "data.json", "storage"  # of a data set: what its numbers are, and the folder of the numbers
FORMAT, VERSION = "uavrl.data", 1
_PLACE_IN_BUFFER = "index"  # the key under which TorchRL's buffers store where a transition is
_PART = 50_000  # transitions that are read at a time: a checkpoint keeps each frame once, and a data set F times


@dataclass(frozen=True)
class Recorded:
    """The whole episodes in the replay buffer of a run, in the order in which they were flown."""

    path: Path  #: of the checkpoint
    config: DictConfig  #: of the run
    metadata: dict[str, Any]  #: of the checkpoint
    storage: FrameStorage
    places: Tensor  #: ``[N]``, of the transitions in ``storage``
    episode: Tensor  #: ``[N]``, the number of the episode of each, from 0
    last: Tensor  #: ``[E]``, which of the N are the last of their episodes

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, rows: slice) -> TensorDictBase:
        """Some of the transitions, with whole observations and the numbers of their episodes."""
        part = self.storage.get(self.places[rows]).exclude(_PLACE_IN_BUFFER, EPISODE)
        return part.set(EPISODE, self.episode[rows])

    def outcomes(self) -> list[str]:
        """What each episode ended with: arrived, collided or timed_out."""
        ends = self.storage.get(self.places[self.last])["next"]
        arrived, terminated = (ends[key].flatten().tolist() for key in ("arrived", "terminated"))
        return [
            "arrived" if there else "collided" if over else "timed_out"
            for there, over in zip(arrived, terminated, strict=True)
        ]

    def parts(self) -> Iterator[TensorDictBase]:
        """All transitions in parts."""
        for first in range(0, len(self), _PART):
            yield self[first : first + _PART]


class _StoredTransitions(BufferState):
    """The transitions of a checkpoint's replay buffer, whatever sampler it has."""

    def __init__(self) -> None:
        self.storage = FrameStorage(1)
        self.cursor = self.written = 0

    def load(self, path: Path) -> None:
        """Reads the files of a :class:`~uavrl.runs.checkpoint.BufferState`."""
        if json.loads((path / "length.json").read_text(encoding="utf-8")):
            self.storage = FrameStorage.saved_at(path / "storage")
            writer = json.loads((path / "writer/metadata.json").read_text(encoding="utf-8"))
            self.cursor, self.written = int(writer["cursor"]), int(writer["write_count"])


def read_recorded(run_dir: Path, checkpoint: str | None = None) -> Recorded:
    """The whole episodes in the replay buffer of a checkpoint, by default the newest.

    A full buffer overwrites its oldest transitions; the rest of an episode that was cut so is left out.

    Raises:
        UavrlError: when there is no run, its checkpoint is damaged, or it holds no whole episode.
    """
    check_links(run_dir, (CONFIG, CHECKPOINTS))
    path = checkpoint_path(run_dir, checkpoint)
    config = read_config(run_dir)
    metadata = check_checkpoint(path, config)
    stored = _StoredTransitions()
    restore(Checkpoint(replay_data=stored), path, ["replay_data"])
    cut = stored.written > len(stored.storage)
    order = torch.arange(len(stored.storage)).roll(-stored.cursor if cut else 0)
    last = _ends(stored.storage)[order].nonzero().flatten() if len(order) else order
    first = int(last[0]) + 1 if cut and len(last) else 0
    last = last[last >= first] - first
    if not len(last):
        remedy = "train with a larger buffer.capacity, which holds at least one" if cut else "train it longer"
        raise UavrlError(f"Expected whole episodes in the replay buffer of {path} and found none: {remedy}.")
    episode = torch.arange(len(last)).repeat_interleave(last.diff(prepend=torch.tensor([-1])))
    places = order[first : first + len(episode)]
    return Recorded(path, config, metadata, stored.storage, places, episode, last)


def _ends(storage: FrameStorage) -> Tensor:
    """Whether each transition is the last of its episode, ``[len]``."""
    done = storage.column(("next", "done")).flatten()
    if storage.get(slice(0, 1)).get("steps_to_next_obs", None) is None:
        return done
    return done & (storage.column("steps_to_next_obs").flatten() == 1)  # n-step transitions are done before the end


def load_data(
    folder: str | Path, *, checkpoint: str | Path | None = None, batch_size: int | None = None
) -> TensorDictReplayBuffer:
    """Load the transitions of a run as a replay buffer to sample from.

    Each transition has whole (stacked) observations. ``episode`` is the number of its episode, from 0. Episodes are in
    the order in which they were flown, and their transitions are next to each other, so that TorchRL's
    :class:`~torchrl.data.SliceSampler` with ``traj_key="episode"`` finds them. The other keys are those of TorchRL
    (``observation``, ``action``, ``next``), and ``demonstrator_action`` in a run with a demonstrator.

    Args:
        folder: a data set that ``uavrl-export run=RUN_FOLDER data=FOLDER`` wrote, whose files are mapped into memory;
            or the folder of a run, whose data set is read into memory.
        checkpoint: the file of one of a run's checkpoints; None: the newest.
        batch_size: transitions that ``sample()`` returns; None: as many as ``sample(N)`` asks for.

    Returns:
        A buffer that cannot be written to. Nothing in the files is executed.

    Raises:
        UavrlError: where there are no data, or their files are damaged or do not come from uavrl.

    Examples:
        >>> import uavrl
        >>> buffer = uavrl.load_data("my_data", batch_size=512)  # doctest: +SKIP
        >>> buffer.sample()["observation"].shape  # doctest: +SKIP
        torch.Size([512, 237])
    """
    place = Path(folder).expanduser()
    whole = isinstance(batch_size, Integral) and not isinstance(batch_size, bool) and batch_size >= 1
    if batch_size is not None and not whole:
        raise UavrlError(f"batch_size must be a whole number of transitions, 1 or more, or None, got {batch_size!r}.")
    storage: Storage
    if (place / DATA).is_file():
        if checkpoint is not None:
            raise UavrlError(f"{place} is a data set, which has no checkpoints: leave checkpoint out.")
        storage = _read_storage(place)
    elif (place / STORAGE).is_dir():
        raise UavrlError(f"The data set {place} is incomplete, because {DATA} is missing: write it again.")
    elif place.is_dir() and not (place / CONFIG).is_file():
        raise UavrlError(
            f"{place} is neither a data set ({DATA}) nor the folder of a run ({CONFIG}): name one of them."
        )
    else:
        recorded = read_recorded(place, None if checkpoint is None else str(checkpoint))
        storage = FrameStorage(len(recorded), recorded.storage.frames)
        done = 0
        for part in recorded.parts():
            storage.set(torch.arange(done, done + len(part)), part)
            done += len(part)
    return TensorDictReplayBuffer(storage=storage, writer=ImmutableDatasetWriter(), batch_size=batch_size)


def _read_storage(folder: Path) -> TensorStorage:
    """The storage of a data set, which somebody else may have written."""
    again = "write the data set again with uavrl-export"
    try:
        about = json.loads((folder / DATA).read_bytes())
        known = (about["format"], about["version"]) == (FORMAT, VERSION)
    except (ValueError, KeyError, TypeError, RecursionError):
        known = False
    if not known:
        raise UavrlError(
            f"{folder / DATA} does not describe a data set that this version of uavrl can read ({FORMAT}, version "
            f"{VERSION}): {again}."
        )
    check_links(folder, (DATA, STORAGE))
    try:
        check_tensors(folder / STORAGE)
        data = tensordict.load(folder / STORAGE, allow_pickle=False)
        rows = {len(value) for value in data.values(include_nested=True, leaves_only=True)}
        if data.ndim != 1 or rows != {len(data)}:
            raise ValueError(f"expected {list(data.shape)} transitions in all entries, got {sorted(rows)}")
    except UavrlError:
        raise
    except Exception as error:
        raise UavrlError(f"The data set {folder} is damaged ({error}): {again}.") from error
    if (wrong := _differs(about, data)) is not None:
        raise UavrlError(
            f"The data set {folder} is not that of its {DATA}, which {wrong}: copy all of it again, or {again}."
        )
    return TensorStorage(data)


def _differs(about: Any, data: TensorDictBase) -> str | None:
    """What the description of a data set says otherwise than its tensors; None where both agree."""
    keys = about.get("keys") if isinstance(about, dict) else None
    if not isinstance(keys, dict):
        return "describes no entries"
    if about.get("transitions") != len(data):
        return f"tells of {about.get('transitions')} transitions, and there are {len(data)}"
    stored = {".".join((key,) if isinstance(key, str) else key): key for key in data.keys(True, True)}
    for name in sorted(stored.keys() | keys.keys()):
        if name not in stored or not isinstance(keys.get(name), dict):
            return f"{'lacks' if name in stored else 'also describes'} {name}"
        value, told = data.get(stored[name]), keys[name]
        shape, dtype = list(value.shape[1:]), str(value.dtype).removeprefix("torch.")
        if (shape, dtype) != (told.get("shape"), told.get("dtype")):
            return f"tells of {name} as {told.get('dtype')} {told.get('shape')}, and it is {dtype} {shape}"
    return None
