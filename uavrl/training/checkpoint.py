"""Checkpoints: what they hold and how a damaged or foreign one is told from a good one."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tensordict
import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.checkpoint import Checkpoint, CheckpointRotation, DumpLoadCheckpointAdapter, GlobalRNGState
from torchrl.data import ReplayBuffer

from uavrl.configs.saved import load_config
from uavrl.errors import UavrlError
from uavrl.pretraining.recording import StateRecorder
from uavrl.training.without_pickles import StateDictWithoutPickles
from uavrl.trust import check_archive

CHECKPOINTS = "checkpoints"
CONFIG = "config.yaml"
# What may differ between a run and its continuation: none of it changes what is learned.
FREE_KEYS = (
    "run_dir",
    "resume",
    "logger",
    "trainer.episodes",
    "trainer.until_success",
    "trainer.progress",
    "trainer.record_states",
    "trainer.keep_checkpoints",
)


class BufferState:
    """Dumps the filled part of a replay buffer with a :class:`~uavrl.buffers.FrameStorage`, not its whole capacity."""

    def __init__(self, buffer: ReplayBuffer) -> None:
        self.buffer = buffer

    def dump(self, path: Path) -> None:
        """Writes data, write cursor and sampler below ``path``."""
        path = Path(path)
        (path / "length.json").write_text(json.dumps(len(self.buffer)))
        if len(self.buffer):
            self.buffer.storage.dumps(path / "storage")
            self.buffer.writer.dumps(path / "writer")
            self.buffer.sampler.dumps(path / "sampler")

    def load(self, path: Path) -> None:
        """Restores what :meth:`dump` wrote."""
        path = Path(path)
        length = json.loads((path / "length.json").read_text())
        if length:
            self.buffer.writer.loads(path / "writer")
            self.buffer.sampler.loads(path / "sampler")
            saved = tensordict.load(path / "storage", allow_pickle=False)
            if saved.get("frames", None) is not None:
                self.buffer.storage.load_state_dict(saved)
            else:  # up to version 0.1 checkpoints held every state as it was sampled
                oldest_first = (torch.arange(length) + self.buffer.writer._cursor) % length
                self.buffer.storage.set(oldest_first, saved[oldest_first].clone())


class RecordingState:
    """How many episodes a recording held: loading it cuts the recording back to where the checkpoint was made.

    Args:
        recorder: the recording, or None where none is made.
    """

    def __init__(self, recorder: StateRecorder | None) -> None:
        self.recorder = recorder
        self._loaded = 0

    def state_dict(self) -> dict[str, Any]:
        """The number of episodes; while nothing is recorded, that of before."""
        return {"episodes": self._loaded if self.recorder is None else self.recorder.episodes}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Cuts the recording back."""
        self._loaded = state_dict["episodes"]
        if self.recorder is not None:
            self.recorder.truncate(state_dict["episodes"])


class RandomState(GlobalRNGState):
    """The process-wide generators; NumPy's would read beyond its memory from a position that it cannot have."""

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave.

        Raises:
            ValueError: for a position outside the 624 numbers of a Mersenne Twister.
        """
        position = state_dict["numpy"][2]
        if not 0 <= position <= 624:
            raise ValueError(f"Expected NumPy's generator at a position from 0 to 624, got {position}.")
        super().load_state_dict(state_dict)


def fingerprint(config: DictConfig) -> str:
    """A hash of everything in a resolved configuration that changes what is learned."""
    plain = OmegaConf.create(OmegaConf.to_container(config, resolve=True))
    for key in FREE_KEYS:
        parent, _, leaf = key.rpartition(".")
        node = OmegaConf.select(plain, parent) if parent else plain
        if isinstance(node, DictConfig) and leaf in node:
            del node[leaf]
    text = json.dumps(OmegaConf.to_container(plain), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def rotation(run_dir: Path, keep: int = 2) -> CheckpointRotation:
    """The rotating checkpoints of a run folder."""
    return CheckpointRotation(run_dir / CHECKPOINTS, keep_last=keep)


def all_checkpoints(run_dir: Path) -> list[Path]:
    """The checkpoints of a run, oldest first, whether they can be read or not.

    Raises:
        UavrlError: when there is no run or no checkpoint.
    """
    _require_folder(run_dir)
    found = sorted((run_dir / CHECKPOINTS).glob("checkpoint*"))
    if not found:
        raise UavrlError(
            f"Expected a checkpoint in {run_dir / CHECKPOINTS} and found none: bring the run's checkpoints back, or "
            f"start a new run in another folder."
        )
    return found


def _require_folder(run_dir: Path) -> None:
    if not run_dir.is_dir():
        raise UavrlError(
            f"Expected a run folder at {run_dir} and found none: give the folder that uavrl-train printed."
        )


def latest_checkpoint(run_dir: Path) -> Path:
    """The newest checkpoint of a run.

    Raises:
        UavrlError: when there is no run or no checkpoint, or the newest cannot be opened.
    """
    newest = all_checkpoints(run_dir)[-1]
    if not zipfile.is_zipfile(newest):
        raise _damaged(newest, "it cannot be opened")
    return newest


def read_config(run_dir: Path) -> DictConfig:
    """The resolved configuration of a run.

    Raises:
        UavrlError: when it is missing or no yaml.
    """
    _require_folder(run_dir)
    path = run_dir / CONFIG
    if not path.is_file():
        raise UavrlError(f"The folder {run_dir} holds no run, for want of {CONFIG}: give one that uavrl-train printed.")
    try:
        config = load_config(path)
    except Exception as error:
        raise UavrlError(f"{path} is damaged: {' '.join(str(error).split())[:300]}.") from error
    if "algo" not in config:
        raise UavrlError(f"Expected the configuration of a run in {path}, it holds something else.")
    return config


def check_checkpoint(path: Path, config: DictConfig) -> dict[str, Any]:
    """Checks that the archive is whole, nothing in it can run, and it belongs to ``config``, before anything is built.

    Returns:
        The checkpoint's metadata.

    Raises:
        UavrlError: when the archive is damaged, holds what uavrl does not write, or was written under another
            configuration.
    """
    try:
        metadata: dict[str, Any] = check_archive(path)["metadata"]
        written_under = metadata["fingerprint"]
        _ = metadata["collected_frames"], metadata["episodes"]
    except UavrlError:
        raise
    except Exception as error:
        raise _damaged(path, str(error)) from error
    if written_under != fingerprint(config):
        raise UavrlError(
            f"The checkpoint {path} was written under another configuration than the one given: "
            f"resume it with the {CONFIG} of its own run folder."
        )
    return metadata


def restore(checkpoint: Checkpoint, path: Path, components: list[str]) -> None:
    """Restores components from an archive that :func:`check_checkpoint` found good.

    Raises:
        UavrlError: when a component does not fit.
    """
    checkpoint.register_adapter(object, StateDictWithoutPickles())
    checkpoint.register_adapter(BufferState, DumpLoadCheckpointAdapter())
    try:
        checkpoint.load(path, components=components, map_location="cpu")
    except Exception as error:
        if isinstance(error.__cause__, UavrlError):
            raise error.__cause__ from None
        raise _damaged(path, str(error)) from error


class DamagedCheckpoint(UavrlError):
    """A checkpoint that cannot be read to its end."""


def _damaged(path: Path, reason: str) -> DamagedCheckpoint:
    return DamagedCheckpoint(f"The checkpoint {path} is damaged ({reason}).")
