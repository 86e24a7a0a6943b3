"""The states of a training run, out of the replay buffer of its newest checkpoint."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf
from tensordict import TensorDict
from torchrl.checkpoint import Checkpoint

from uavrl.buffers import FrameStorage
from uavrl.errors import UavrlError
from uavrl.models.psae import form_of_states
from uavrl.runs.checkpoint import BufferState, check_checkpoint, latest_checkpoint, restore
from uavrl.runs.config import read_config
from uavrl.runs.names import CHECKPOINTS, CONFIG, PRETRAINED
from uavrl.runs.trust import check_links

_PART = 100_000  # states that are read at a time


@dataclass(frozen=True)
class States:
    """States of whole episodes, end to end.

    Attributes:
        states: ``[N, width]`` float32.
        episode: ``[N]``, the index of the episode that each state belongs to, from 0.
        outcomes: of each episode: arrived, collided or timed_out.
        name: where they come from, for people to read.
        perception: the keys of the run's perception that decide what their numbers mean.
    """

    states: np.ndarray
    episode: np.ndarray
    outcomes: list[str]
    name: str
    perception: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.states)

    def sha256(self) -> str:
        """The checksum of the states as float32, little endian."""
        return hashlib.sha256(np.ascontiguousarray(self.states, "<f4").data).hexdigest()


def triple_centres(episode: np.ndarray) -> np.ndarray:
    """The indices t ``[M]``, ascending, for which t-1, t and t+1 belong to one episode.

    Args:
        episode: ``[N]``, the episode that each state belongs to, else ValueError; states of an episode lie together.

    Examples:
        >>> triple_centres(np.array([0, 0, 0, 0, 1, 1, 2, 2, 2]))
        array([1, 2, 7])
    """
    if episode.ndim != 1:
        raise ValueError(f"Expected the episodes [N] of N states, got {list(episode.shape)}.")
    inside = (episode[1:-1] == episode[:-2]) & (episode[1:-1] == episode[2:])
    return np.flatnonzero(inside) + 1


class _StoredTransitions(BufferState):
    """The transitions of a checkpoint's replay buffer, whatever sampler it has."""

    def __init__(self) -> None:
        self.storage = FrameStorage(1)
        self.next_place = 0  # where the next transition would have gone

    def load(self, path: Path) -> None:
        """Reads the files of a :class:`~uavrl.runs.checkpoint.BufferState`."""
        if json.loads((path / "length.json").read_text(encoding="utf-8")):
            self.storage = FrameStorage.saved_at(path / "storage")
            self.next_place = int(json.loads((path / "writer/metadata.json").read_text(encoding="utf-8"))["cursor"])


def read_states(run_dir: Path) -> States:
    """The states of the whole episodes in a run's folder, in the order in which they were collected.

    A full buffer has begun to overwrite its oldest transitions; the rest of the episode that was cut is left out.

    Raises:
        UavrlError: when there is no run, its checkpoint is damaged, or it holds no whole episode of finite states.
    """
    check_links(run_dir, (CONFIG, CHECKPOINTS, PRETRAINED))
    path = latest_checkpoint(run_dir)
    config = read_config(run_dir)
    check_checkpoint(path, config)
    stored = _StoredTransitions()
    restore(Checkpoint(replay_data=stored), path, ["replay_data"])
    full = len(stored.storage) >= int(config.buffer.capacity)
    steps = _in_order(stored.storage, stored.next_place if full else 0)
    last = steps["last"].nonzero().flatten()
    first = int(last[0]) + 1 if full and len(last) else 0
    last = last[last >= first]
    if not len(last):
        raise UavrlError(f"Expected whole episodes in the replay buffer of {path} and found none: train it longer.")
    states = steps["observation"][first : int(last[-1]) + 1].float()
    if not states.isfinite().all():
        raise UavrlError(f"Expected finite states in {run_dir}, found NaN or infinity: train another run.")
    episode = torch.arange(len(last)).repeat_interleave(last.diff(prepend=torch.tensor([first - 1])))
    ends = steps[last]
    outcomes = [
        "arrived" if arrived else "collided" if terminated else "timed_out"
        for arrived, terminated in zip(ends["arrived"].tolist(), ends["terminated"].tolist(), strict=True)
    ]
    seen = OmegaConf.to_container(config).get("perception") or {}  # type: ignore[union-attr]
    if not isinstance(seen, dict):
        raise UavrlError(f"Expected perception in the configuration of {run_dir} to be a mapping, got {seen!r:.80}.")
    name = f"{run_dir.resolve().name}/{path.relative_to(run_dir)}"  # of no place on this machine: it is given away
    return States(states.numpy(), episode.numpy(), outcomes, name, form_of_states(seen))


def _in_order(storage: FrameStorage, oldest: int) -> TensorDict:
    """States and flags of each stored step ``[N]``, from the place of the oldest on."""
    if not len(storage):
        return TensorDict({"last": torch.zeros(0, dtype=torch.bool)}, [0])
    parts = []
    for places in torch.arange(len(storage)).roll(-oldest).split(_PART):  # in parts: next states are read too
        found = storage.get(places)
        flags = {key: found["next", key].flatten() for key in ("done", "terminated", "arrived")}
        last = flags.pop("done")
        if (ahead := found.get("steps_to_next_obs", None)) is not None:  # n-step transitions are done before the end
            last = last & (ahead.flatten() == 1)
        parts.append(TensorDict({"observation": found["observation"], "last": last, **flags}, [len(places)]))
    return torch.cat(parts)
