"""Checkpoints: what they hold, how a damaged or foreign one is found, and from which one a run goes on."""

import json
import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tensordict
from omegaconf import DictConfig
from torchrl.checkpoint import (
    Checkpoint,
    CheckpointRotation,
    DumpLoadCheckpointAdapter,
    GlobalRNGState,
    StateDictCheckpointAdapter,
)
from torchrl.data import ReplayBuffer

from uavrl.config.command_line import command_line, trusting
from uavrl.errors import UavrlError
from uavrl.runs.config import fingerprint, read_config, require_folder
from uavrl.runs.episodes import read_episodes
from uavrl.runs.names import ANY_CHECKPOINT, CHECKPOINTS, CONFIG, EPISODES
from uavrl.runs.trust import check_archive
from uavrl.upstream import decode_state_dict

log = logging.getLogger(__name__)


class BufferState:
    """Dumps the filled part of a replay buffer with a :class:`~uavrl.buffers.FrameStorage`."""

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


class StateDictWithoutPickles(StateDictCheckpointAdapter):
    """Reads the one payload that uavrl writes, a folder, and refuses the pickles that TorchRL's own would read."""

    def load(self, component: Any, path: Path, *, map_location: Any, args: Any, kwargs: Any, **_: Any) -> None:
        """Restores ``component`` from ``path``."""
        tensors = tensordict.load(path / self.state_directory, allow_pickle=False)
        schema = json.loads((path / self.schema_filename).read_text(encoding="utf-8"))
        component.load_state_dict(decode_state_dict(schema, tensors, map_location), *args, **kwargs)


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


def checkpoint_path(run_dir: Path, checkpoint: str | None) -> Path:
    """The file of the checkpoint named, or of the run's newest."""
    path = Path(checkpoint) if checkpoint else latest_checkpoint(run_dir)
    if not path.is_file():
        raise UavrlError(f"Expected a checkpoint at {path} and found none: leave checkpoint out to take the newest.")
    return path


def check_checkpoint(path: Path, config: DictConfig) -> dict[str, Any]:
    """The metadata of an archive that is whole, has nothing in it that can run, and belongs to ``config``."""
    try:
        metadata: dict[str, Any] = check_archive(path)["metadata"]
        written_under = metadata["fingerprint"]
        _ = metadata["collected_frames"], metadata["episodes"], metadata["seconds"]
    except UavrlError:
        raise
    except Exception as error:
        raise DamagedCheckpoint(path, error) from error
    if written_under != fingerprint(config):
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
        raise DamagedCheckpoint(path, error) from error


class DamagedCheckpoint(UavrlError):
    """A checkpoint that cannot be read to its end."""

    def __init__(self, path: Path, reason: object) -> None:
        self.fault = f"The checkpoint {path} is damaged ({reason})"
        super().__init__(f"{self.fault}: uavrl-train resume=RUN_FOLDER goes back to the one before, if there is one.")


def checkpoint_to_resume(run_dir: Path, config: DictConfig) -> Path:
    """The newest checkpoint that is whole and knows no episode that ``episodes.csv`` has lost.

    Newer ones are renamed, so that nothing takes them for the run's, and what happened is logged. What ``config`` may
    change of the recorded one does not bear on the checkpoints.
    """
    recorded = read_config(run_dir)
    if fingerprint(config) != fingerprint(recorded):
        raise UavrlError(
            f"{run_dir} was trained under another configuration than the one given: go on with its own, or start a new "
            f"run."
        )
    found = all_checkpoints(run_dir)
    flown = len(read_episodes(run_dir / EPISODES))
    passed_over: dict[Path, str] = {}
    for path in reversed(found):
        try:
            saved = check_checkpoint(path, recorded)["episodes"]
        except DamagedCheckpoint as error:
            passed_over[path] = f"{error.fault}."
            continue
        if saved <= flown:
            for newer, reason in passed_over.items():
                aside = newer.replace(newer.with_name(f"unused-{newer.name}"))
                told = "%s The run goes back to the one before, after episode %d; this one is now %s."
                log.warning(told, reason, saved, aside)
            return path
        passed_over[path] = (
            f"The checkpoint {path} follows episode {saved}, and {run_dir / EPISODES} has lost those after {flown}."
        )
    raise UavrlError(
        f"{passed_over[found[-1]]} No older checkpoint is left to go on from: bring the file back, or start a new run."
    )


def how_to_go_on(run_dir: Path, packages: Iterable[str] = ()) -> str:
    """The sentence that a stopped run ends with; ``packages`` are those that its parts come from."""
    go_on = command_line("uavrl-train", resume=run_dir, **trusting(packages))
    if not any(run_dir.glob(ANY_CHECKPOINT)):
        return f"stopped before the first episode: start it again, or {go_on}."
    try:
        saved = Checkpoint.manifest(all_checkpoints(run_dir)[-1])["metadata"]["episodes"]
        flown = len(read_episodes(run_dir / EPISODES))
    except Exception:  # damaged meanwhile: whoever goes on is told what, and nothing may hide that the run was stopped
        return f"stopped: resume with {go_on}."
    if flown == saved == 0:
        return f"stopped before the first episode has ended: resume with {go_on}."
    if flown == saved:
        return f"stopped after episode {flown}, which is saved: resume with {go_on}."
    again = f"episode {flown}" if flown == saved + 1 else f"episodes {saved + 1} to {flown}"
    return f"stopped after episode {flown}: {go_on} continues after episode {saved} and repeats {again}."
