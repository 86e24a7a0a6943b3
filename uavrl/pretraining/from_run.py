"""Recorded states of a training run: its ``states`` folder, or the replay buffer of its newest checkpoint."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from uavrl.errors import UavrlError
from uavrl.pretraining.recording import HEADER, Recording, read_recording
from uavrl.trust import check_archive, check_links

STATES_FOLDER = "states"


def open_source(recording: str | None, run: str | None) -> Recording:
    """Opens a recording, or the states of a run.

    Args:
        recording: a recording's folder.
        run: a run's folder, instead. Its ``states`` folder is read where there is one, else the replay buffer of
            its newest checkpoint.

    Raises:
        UavrlError: when both or neither is given, nothing is found, or the states are not finite.
    """
    if (recording is None) == (run is None):
        raise UavrlError("Give either run=RUN_FOLDER or recording=FOLDER, and not both.")
    found = read_recording(recording) if recording is not None else read_run(Path(str(run)))
    for start in range(0, len(found), 100_000):  # in parts: the states may not fit into memory
        if not np.isfinite(found.states[start : start + 100_000]).all():
            raise UavrlError(f"Expected finite states in {recording or run}, found NaN or infinity: record them anew.")
    return found


def read_run(run_dir: Path) -> Recording:
    """The states of a run's whole episodes.

    Raises:
        UavrlError: when there is no run, or it has neither a recording nor a checkpoint.
    """
    from uavrl.training.checkpoint import latest_checkpoint

    check_links(run_dir)
    if (run_dir / STATES_FOLDER / HEADER).is_file():
        found = read_recording(run_dir / STATES_FOLDER)
        return Recording(found.states, found.episode, found.outcomes, f"{run_dir.name}/{STATES_FOLDER}")
    return read_checkpoint(latest_checkpoint(run_dir), _capacity(run_dir))


def _capacity(run_dir: Path) -> int:
    from uavrl.training.checkpoint import read_config

    return int(read_config(run_dir).buffer.capacity)


def read_checkpoint(path: Path, capacity: int) -> Recording:
    """The states in a checkpoint's replay buffer, in the order in which they were flown.

    A full buffer has begun to overwrite its oldest transitions; what is left of the episode cut into is left out.

    Args:
        path: the checkpoint.
        capacity: transitions that the buffer can hold.

    Raises:
        UavrlError: when the archive is damaged, or holds no whole episode.
    """
    try:
        check_archive(path)
        with zipfile.ZipFile(path) as archive:
            prefix = json.loads(archive.read("manifest.json"))["components"]["replay_data"]["path"]
            length = json.loads(archive.read(f"{prefix}/length.json"))
            cursor = json.loads(archive.read(f"{prefix}/writer/metadata.json"))["cursor"] if length else 0
            states = _read_states(archive, f"{prefix}/storage", length)
            folder = _transitions(archive, f"{prefix}/storage")
            done, terminated, arrived = (
                _read(archive, f"{folder}/next", key, length).reshape(length).astype(bool)
                for key in ("done", "terminated", "arrived")
            )
    except UavrlError:
        raise
    except Exception as error:
        raise UavrlError(
            f"The replay buffer in the checkpoint {path} cannot be read ({error}): give another run, or a recording."
        ) from error
    first = 0
    if length >= capacity:
        oldest = int(cursor) % length
        states, done, terminated, arrived = (np.roll(x, -oldest, 0) for x in (states, done, terminated, arrived))
        first = int(done.argmax()) + 1
    ends = np.flatnonzero(done)
    ends = ends[ends >= first]
    if len(ends) == 0:
        raise UavrlError(f"Expected whole episodes in the replay buffer of {path} and found none: let it fly longer.")
    outcomes = ["arrived" if arrived[e] else "collided" if terminated[e] else "timed_out" for e in ends]
    lengths = np.diff(ends, prepend=first - 1).tolist()
    found = Recording.from_lengths(states[first : ends[-1] + 1], lengths, outcomes, path.name)
    return Recording(found.states, found.episode, outcomes, f"{path.parent.parent.name}/{path.name}")


def _transitions(archive: zipfile.ZipFile, folder: str) -> str:
    """Where the transitions lie; up to version 0.1 that is the storage itself, which held every state whole."""
    return f"{folder}/transitions" if f"{folder}/transitions/meta.json" in archive.namelist() else folder


def _read_states(archive: zipfile.ZipFile, folder: str, length: int) -> np.ndarray:
    """The states ``[length, F * W]`` from a storage's frames (:class:`uavrl.buffers.FrameStorage`)."""
    transitions = _transitions(archive, folder)
    if transitions == folder:
        return _read(archive, folder, "observation", length)
    frames, first = _read(archive, folder, "frames"), _read(archive, transitions, "first_frame", length)
    numbers = first[:, None] + np.arange(int(_read(archive, folder, "stacked")))
    if not 0 <= numbers.min() <= numbers.max() < len(frames):
        raise ValueError(f"expected {numbers.max() + 1} frames, found {len(frames)}")
    return frames[numbers].reshape(length, -1)


def _read(archive: zipfile.ZipFile, folder: str, key: str, length: int | None = None) -> np.ndarray:
    """One tensor of the storage, with ``length`` rows if that is given, as its ``meta.json`` describes it."""
    if length == 0:
        return np.zeros((0, 1), np.float32)
    about: dict[str, Any] = json.loads(archive.read(f"{folder}/meta.json"))[key]
    dtype = {"torch.float32": "<f4", "torch.float64": "<f8", "torch.bool": "?", "torch.int64": "<i8"}[about["dtype"]]
    values = np.frombuffer(archive.read(f"{folder}/{key}.memmap"), dtype).reshape(about["shape"])
    if length is not None and len(values) != length:
        raise ValueError(f"expected {length} rows of {key}, found the shape {list(values.shape)}")
    return values.astype("<f4", copy=False) if values.dtype.kind == "f" else values
