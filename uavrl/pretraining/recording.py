"""States of whole episodes on disk: written while a training flies, read to pre-train PSAE.

A recording is a folder of three files: ``recording.json`` (format, version, width), ``states.f32`` (the states end
to end, float32, little endian) and ``episodes.csv`` (one row for each episode: its number, states and outcome).
An episode counts once its row is written, which happens after its states are on the disk.
"""

from __future__ import annotations

import csv
import json
import logging
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from torch import Tensor

from uavrl.errors import UavrlError
from uavrl.files import replacing

log = logging.getLogger(__name__)

FORMAT = "uavrl.recording"
VERSION = 1
HEADER, STATES, EPISODES = "recording.json", "states.f32", "episodes.csv"
COLUMNS = ["episode", "states", "outcome"]
OUTCOMES = ("arrived", "collided", "timed_out")
FLOAT32 = np.dtype("<f4")


@dataclass(frozen=True)
class Recording:
    """States of whole episodes, end to end.

    Attributes:
        states: ``[N, width]`` float32.
        episode: ``[N]`` int32, the index of the episode that each state belongs to, from 0.
        outcomes: of each episode: arrived, collided or timed_out.
        name: where they come from, for people to read.
        details: more about where they come from, goes into the artifact's provenance.
    """

    states: np.ndarray
    episode: np.ndarray
    outcomes: list[str]
    name: str = "recording"
    details: dict[str, object] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.states)

    @staticmethod
    def from_lengths(states: np.ndarray, lengths: list[int], outcomes: list[str], name: str) -> Recording:
        """Builds one from the number of states of each episode.

        Examples:
            >>> Recording.from_lengths(np.zeros((3, 5)), [2, 1], ["arrived", "collided"], "example").episode
            array([0, 0, 1], dtype=int32)
        """
        return Recording(states, np.repeat(np.arange(len(lengths), dtype=np.int32), lengths), outcomes, name)


class StateRecorder:
    """Appends the states of whole episodes to a recording, new or begun before.

    What a killed process left of an unfinished episode is cut off when the recording is opened.

    Args:
        path: the recording's folder.
        width: numbers in a state.

    Raises:
        UavrlError: when the folder holds something else, or states of another width.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     recorder = StateRecorder(folder, width=3)
        ...     recorder.add(np.zeros((4, 3)), "arrived")
        ...     recorder.add(np.ones((2, 3)), "collided")
        ...     recorder.truncate(1)
        ...     recording = read_recording(folder)
        >>> recording.states.shape, recording.outcomes
        ((4, 3), ['arrived'])
    """

    def __init__(self, path: str | Path, width: int = 105) -> None:
        self.path = Path(path)
        self.width = width
        if not self.path.exists() or self._only_begun():
            self._create()
        if _read_header(self.path) != width:
            raise UavrlError(
                f"Expected states of {width} numbers in {self.path}, it holds states of {_read_header(self.path)}: "
                f"record into another folder."
            )
        self._lengths, self._outcomes = _read_episodes(self.path)
        self._repair()

    def _only_begun(self) -> bool:
        """Whether the folder is empty, or holds what a process left that was killed while it made the recording."""
        left = {file.name for file in self.path.iterdir()} <= {STATES, EPISODES, f"{HEADER}.partial"}
        return left and not ((self.path / STATES).exists() and (self.path / STATES).stat().st_size)

    def _create(self) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        (self.path / STATES).touch()
        with (self.path / EPISODES).open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow(COLUMNS)
        header = {"format": FORMAT, "version": VERSION, "width": self.width, "dtype": "float32, little endian"}
        with replacing(self.path / HEADER) as partial:  # last: a folder without it is no recording
            partial.write_text(json.dumps(header) + "\n")

    @property
    def episodes(self) -> int:
        """How many episodes are recorded."""
        return len(self._lengths)

    @property
    def states(self) -> int:
        """How many states are recorded."""
        return sum(self._lengths)

    def add(self, states: np.ndarray | Tensor, outcome: str) -> None:
        """Appends one whole episode.

        Args:
            states: ``[T, width]``, the state before each action.
            outcome: arrived, collided or timed_out.

        Raises:
            UavrlError: for another shape or outcome, or states that are not finite.
        """
        values = np.ascontiguousarray(states.detach().cpu() if isinstance(states, Tensor) else states, FLOAT32)
        if values.ndim != 2 or values.shape[1] != self.width or len(values) == 0:
            raise UavrlError(f"Expected the states [T, {self.width}] of one episode, got {list(values.shape)}.")
        if outcome not in OUTCOMES:
            raise UavrlError(f"Expected an outcome out of {', '.join(OUTCOMES)}, got {outcome!r}.")
        if not np.isfinite(values).all():
            raise UavrlError("Expected finite states, got NaN or infinity: look at the sensor and the scaling.")
        _append(self.path / STATES, values.tobytes())
        _append(self.path / EPISODES, f"{self.episodes},{len(values)},{outcome}\n".encode())
        self._lengths.append(len(values))
        self._outcomes.append(outcome)

    def truncate(self, episodes: int) -> None:
        """Keeps the first ``episodes`` episodes: a resumed run goes on from where its checkpoint was made.

        Raises:
            UavrlError: when there are fewer.
        """
        if not 0 <= episodes <= self.episodes:
            raise UavrlError(
                f"Expected at least {episodes} episodes in {self.path} and found {self.episodes}: "
                f"the recording does not belong to the checkpoint."
            )
        self._lengths, self._outcomes = self._lengths[:episodes], self._outcomes[:episodes]
        rows = [COLUMNS, *zip(range(episodes), self._lengths, self._outcomes, strict=True)]
        with replacing(self.path / EPISODES) as partial, partial.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)  # first the rows: states without a row do not count
        with (self.path / STATES).open("r+b") as file:
            file.truncate(self.states * self.width * FLOAT32.itemsize)

    def _repair(self) -> None:
        """Cuts both files back to the last whole episode that both of them hold."""
        size = (self.path / STATES).stat().st_size
        ends = np.cumsum(self._lengths, dtype=np.int64) * self.width * FLOAT32.itemsize
        whole = int((ends <= size).sum())
        rows_end = (self.path / EPISODES).read_bytes().endswith(b"\n")
        if whole == self.episodes and rows_end and size == (ends[-1] if whole else 0):
            return
        log.warning("The recording %s ended in the middle of an episode: cut to its %d whole ones.", self.path, whole)
        self.truncate(whole)


def read_recording(path: str | Path) -> Recording:
    """Opens a recording without changing it; its states stay on the disk until they are read.

    Args:
        path: the folder that :class:`StateRecorder` wrote. A recording that still grows can be read.

    Raises:
        UavrlError: when the folder is missing, empty of episodes, truncated, or something else.
    """
    path = Path(path)
    width = _read_header(path)
    lengths, outcomes = _read_episodes(path)
    total = sum(lengths)
    if total == 0:
        raise UavrlError(f"Expected episodes in the recording {path} and found none: let the training fly longer.")
    found = (path / STATES).stat().st_size if (path / STATES).is_file() else 0
    if found < total * width * FLOAT32.itemsize:
        raise UavrlError(
            f"{path / STATES} is truncated: {EPISODES} tells of {total} states and the file holds "
            f"{found // (width * FLOAT32.itemsize)}; copy the recording again."
        )
    states = np.memmap(path / STATES, FLOAT32, "r", shape=(total, width))
    return Recording.from_lengths(states, lengths, outcomes, path.name)


def _append(path: Path, content: bytes) -> None:
    with path.open("ab") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _read_header(path: Path) -> int:
    """The width of the states."""
    if not (path / HEADER).is_file():
        raise UavrlError(f"Expected a recording with {path / HEADER} and found no such file: give the states' folder.")
    try:
        header = json.loads((path / HEADER).read_text())
        known = header["format"] == FORMAT and isinstance(header["width"], int) and header["width"] > 0
        version = header["version"]
    except (ValueError, KeyError, TypeError):
        known, version = False, None
    if not known:
        raise UavrlError(f"Expected {path / HEADER} to be of the format {FORMAT}, it holds something else.")
    if version != VERSION:
        raise UavrlError(f"Expected a recording of version {VERSION} in {path}, got version {version}: record it anew.")
    return int(header["width"])


def _read_episodes(path: Path) -> tuple[list[int], list[str]]:
    """States and outcome of each episode; a last row that was not finished is left out."""
    file = path / EPISODES
    if not file.is_file():
        raise UavrlError(f"Expected the episodes of a recording in {file} and found no such file.")
    text = file.read_bytes().decode(errors="replace")
    rows = list(csv.reader(text[: text.rfind("\n") + 1].splitlines()))
    if not rows or rows[0] != COLUMNS:
        raise UavrlError(f"Expected {file} to start with the columns {','.join(COLUMNS)}: it holds something else.")
    try:
        numbers = [int(number) for number, _, _ in rows[1:]]
        lengths, outcomes = [int(length) for _, length, _ in rows[1:]], [outcome for _, _, outcome in rows[1:]]
    except ValueError as error:
        raise UavrlError(f"{file} is damaged: {error}.") from error
    if numbers != list(range(len(numbers))) or min(lengths, default=1) < 1 or not set(outcomes) <= set(OUTCOMES):
        raise UavrlError(f"{file} is damaged: expected the episodes 0 to {len(numbers) - 1}, each once and whole.")
    return lengths, outcomes
