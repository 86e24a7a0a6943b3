"""The states of a training run, out of the replay buffer of its newest checkpoint."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf

from uavrl.errors import UavrlError
from uavrl.export.recorded import read_recorded
from uavrl.models.psae import form_of_states
from uavrl.runs.names import PRETRAINED
from uavrl.runs.trust import check_links


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


def read_states(run_dir: Path) -> States:
    """The states of the whole episodes in a run's folder, in the order in which they were collected.

    A full buffer has begun to overwrite its oldest transitions; the rest of the episode that was cut is left out.

    Raises:
        UavrlError: when there is no run, its checkpoint is damaged, or it holds no whole episode of finite states.
    """
    check_links(run_dir, (PRETRAINED,))
    recorded = read_recorded(run_dir)
    states = torch.cat([part["observation"].float() for part in recorded.parts()])
    if not states.isfinite().all():
        raise UavrlError(f"Expected finite states in {run_dir}, found NaN or infinity: train another run.")
    seen = OmegaConf.to_container(recorded.config).get("perception") or {}  # type: ignore[union-attr]
    if not isinstance(seen, dict):
        raise UavrlError(f"Expected perception in the configuration of {run_dir} to be a mapping, got {seen!r:.80}.")
    # Of no place on this machine: it is given away.
    name = f"{run_dir.resolve().name}/{recorded.path.relative_to(run_dir)}"
    return States(states.numpy(), recorded.episode.numpy(), recorded.outcomes(), name, form_of_states(seen))
