"""Checkpoints: what they hold and how a damaged or foreign one is told from a good one."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from torchrl.checkpoint import Checkpoint, CheckpointRotation, DumpLoadCheckpointAdapter, GlobalRNGState
from torchrl.data import ReplayBuffer

from uavrl.errors import UavrlError
from uavrl.runs.config import fingerprints, require_folder
from uavrl.runs.names import ANY_CHECKPOINT, CHECKPOINTS, CONFIG
from uavrl.runs.trust import check_archive
from uavrl.runs.without_pickles import StateDictWithoutPickles


class BufferState:
    """Dumps the filled part of a replay buffer with a :class:`~uavrl.buffers.FrameStorage`, not its whole capacity."""

    def __init__(self, buffer: ReplayBuffer) -> None:
        self.buffer = buffer

    def dump(self, path: Path) -> None:
        """Writes data, write cursor and sampler below ``path``."""
        path = Path(path)
        (path / "length.json").write_text(json.dumps(len(self.buffer)), encoding="utf-8")
        if len(self.buffer):
            self.buffer.storage.dumps(path / "storage")
            self.buffer.writer.dumps(path / "writer")
            self.buffer.sampler.dumps(path / "sampler")

    def load(self, path: Path) -> None:
        """Restores what :meth:`dump` wrote."""
        path = Path(path)
        if json.loads((path / "length.json").read_text(encoding="utf-8")):
            self.buffer.writer.loads(path / "writer")
            self.buffer.sampler.loads(path / "sampler")
            self.buffer.storage.loads(path / "storage")


class RandomState(GlobalRNGState):
    """The process-wide generators; NumPy's would read beyond its memory from a position that it cannot have."""

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        position = state_dict["numpy"][2]
        if not 0 <= position <= 624:
            raise ValueError(f"Expected NumPy's generator at a position from 0 to 624, got {position}.")
        super().load_state_dict(state_dict)


def rotation(run_dir: Path, keep: int = 2) -> CheckpointRotation:
    """The rotating checkpoints of a run folder."""
    return CheckpointRotation(run_dir / CHECKPOINTS, keep_last=keep)


def all_checkpoints(run_dir: Path) -> list[Path]:
    """The checkpoints of a run, oldest first, whether they can be read or not."""
    require_folder(run_dir)
    found = sorted(run_dir.glob(ANY_CHECKPOINT))
    if not found:
        raise UavrlError(
            f"Expected a checkpoint in {run_dir / CHECKPOINTS} and found none: bring the run's checkpoints back, or "
            f"start a new run in another folder."
        )
    return found


def latest_checkpoint(run_dir: Path) -> Path:
    """The newest checkpoint of a run."""
    return all_checkpoints(run_dir)[-1]


def check_checkpoint(path: Path, config: DictConfig) -> dict[str, Any]:
    """The metadata of an archive that is whole, has nothing in it that can run, and belongs to ``config``."""
    try:
        metadata: dict[str, Any] = check_archive(path)["metadata"]
        written_under = metadata["fingerprint"]
        _ = metadata["collected_frames"], metadata["episodes"]
    except UavrlError:
        raise
    except Exception as error:
        raise _damaged(path, str(error)) from error
    if written_under not in fingerprints(config):
        raise UavrlError(
            f"The checkpoint {path} was written under another configuration than the one given: "
            f"resume it with the {CONFIG} of its own run folder."
        )
    return metadata


def restore(checkpoint: Checkpoint, path: Path, components: list[str]) -> None:
    """Restores components from an archive that :func:`check_checkpoint` found good."""
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
