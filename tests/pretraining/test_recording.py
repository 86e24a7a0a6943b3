"""Recordings survive crashes, resumes and foreign files."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.pretraining.synthetic import record
from uavrl.errors import UavrlError
from uavrl.pretraining import StateRecorder, read_recording

WIDTH = 6


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "states"


def content(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def test_what_is_added_is_read(folder: Path) -> None:
    written = record(folder, episodes=4)
    recording = read_recording(folder)
    assert isinstance(recording.states, np.memmap)
    assert recording.states.dtype == np.float32 and recording.states.shape[1] == WIDTH
    assert np.array_equal(recording.states, np.concatenate(written))
    assert recording.episode.tolist() == [i for i, states in enumerate(written) for _ in states]
    assert recording.episode.dtype == np.int32
    assert recording.outcomes == ["arrived", "collided", "timed_out", "arrived"]


def test_the_file_is_plain_float32_and_rows(folder: Path) -> None:
    recorder = StateRecorder(folder, 2)
    recorder.add(torch.tensor([[1.0, 2.0], [3.0, 4.0]], dtype=torch.float64), "arrived")
    assert (folder / "states.f32").read_bytes() == np.array([1, 2, 3, 4], "<f4").tobytes()
    assert (folder / "episodes.csv").read_text() == "episode,states,outcome\n0,2,arrived\n"
    assert (recorder.episodes, recorder.states) == (1, 2)


def test_an_opened_recording_goes_on(folder: Path) -> None:
    StateRecorder(folder, 2).add(np.zeros((3, 2)), "arrived")
    StateRecorder(folder, 2).add(np.ones((1, 2)), "timed_out")
    assert read_recording(folder).episode.tolist() == [0, 0, 0, 1]


def test_a_growing_recording_can_be_read(folder: Path) -> None:
    written = record(folder, episodes=3)
    with (folder / "states.f32").open("ab") as file:
        file.write(b"\0" * 50)  # states whose row is still to come
    with (folder / "episodes.csv").open("a") as file:
        file.write("3,12,arr")
    before = content(folder)
    assert np.array_equal(read_recording(folder).states, np.concatenate(written))
    assert content(folder) == before


@pytest.mark.parametrize("lost", [1, 4, 4 * WIDTH, 4 * WIDTH * 30])
def test_a_truncated_tail_of_states_is_cut_to_the_last_whole_episode(
    folder: Path, lost: int, caplog: pytest.LogCaptureFixture
) -> None:
    written = record(folder, episodes=6)
    path = folder / "states.f32"
    path.write_bytes(path.read_bytes()[:-lost])
    with caplog.at_level(logging.WARNING):
        recorder = StateRecorder(folder, WIDTH)
    ends = np.cumsum([len(states) for states in written])
    whole = int((ends * WIDTH * 4 <= ends[-1] * WIDTH * 4 - lost).sum())
    assert recorder.episodes == whole < 6
    assert f"cut to its {whole} whole ones" in caplog.text
    recorder.add(written[0], "collided")
    assert np.array_equal(read_recording(folder).states, np.concatenate([*written[:whole], written[0]]))


@pytest.mark.parametrize("cut", range(1, 14))
def test_a_crash_between_states_and_row_loses_that_episode_only(
    folder: Path, cut: int, caplog: pytest.LogCaptureFixture
) -> None:
    written = record(folder, episodes=3)
    rows = folder / "episodes.csv"
    rows.write_bytes(rows.read_bytes()[:-cut])
    recorder = StateRecorder(folder, WIDTH)
    assert "cut to its 2 whole ones" in caplog.text
    assert np.array_equal(read_recording(folder).states, np.concatenate(written[:2]))
    recorder.add(written[2], "timed_out")
    assert np.array_equal(read_recording(folder).states, np.concatenate(written))


def test_a_whole_recording_is_opened_without_a_warning_or_a_change(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record(folder, episodes=3)
    before = content(folder)
    StateRecorder(folder, WIDTH)
    assert content(folder) == before and not caplog.text


def test_a_resumed_run_cuts_back_and_goes_on_as_if_never_stopped(tmp_path: Path) -> None:
    written = record(tmp_path / "one", episodes=6)
    record(tmp_path / "other", episodes=6)
    resumed = StateRecorder(tmp_path / "other", WIDTH)
    resumed.truncate(4)
    assert np.array_equal(read_recording(tmp_path / "other").states, np.concatenate(written[:4]))
    for i in (4, 5):
        resumed.add(written[i], ("arrived", "collided", "timed_out")[i % 3])
    assert content(tmp_path / "one") == content(tmp_path / "other")


def test_a_recording_cut_to_nothing_can_be_filled_again(folder: Path) -> None:
    record(folder, episodes=2)
    recorder = StateRecorder(folder, WIDTH)
    recorder.truncate(0)
    with pytest.raises(UavrlError, match="Expected episodes"):
        read_recording(folder)
    recorder.add(np.ones((2, WIDTH)), "arrived")
    assert len(read_recording(folder)) == 2


@pytest.mark.parametrize("episodes", [-1, 4])
def test_more_episodes_than_there_are_cannot_be_kept(folder: Path, episodes: int) -> None:
    record(folder, episodes=3)
    before = content(folder)
    with pytest.raises(UavrlError, match=f"at least {episodes} episodes in .* found 3"):
        StateRecorder(folder, WIDTH).truncate(episodes)
    assert content(folder) == before


@pytest.mark.parametrize(
    ("states", "outcome", "said"),
    [
        (np.zeros((3, 5)), "arrived", r"states \[T, 6\] of one episode, got \[3, 5\]"),
        (np.zeros(6), "arrived", r"got \[6\]"),
        (np.zeros((0, 6)), "arrived", r"got \[0, 6\]"),
        (np.zeros((3, 6)), "landed", "an outcome out of arrived, collided, timed_out, got 'landed'"),
        (np.full((3, 6), np.nan), "arrived", "finite states"),
        (np.full((3, 6), 1e300), "arrived", "finite states"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_what_is_no_episode_is_refused_and_leaves_nothing(
    folder: Path, states: np.ndarray, outcome: str, said: str
) -> None:
    record(folder, episodes=2)
    recorder, before = StateRecorder(folder, WIDTH), content(folder)
    with pytest.raises(UavrlError, match=said):
        recorder.add(states, outcome)
    assert content(folder) == before and recorder.episodes == 2


def test_a_missing_or_foreign_folder_is_named(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(UavrlError, match=r"recording.json and found no such file"):
        read_recording(tmp_path / "none")
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    for attempt in (read_recording, StateRecorder):
        with pytest.raises(UavrlError, match=r"recording.json and found no such file"):
            attempt(folder)
    assert content(folder) == {"notes.txt": b"mine"}


@pytest.mark.parametrize("header", ["", "[]", "{}", '{"format": "other", "version": 1, "width": 6}', '"text"'])
def test_a_foreign_header_is_refused(folder: Path, header: str) -> None:
    record(folder, episodes=2)
    (folder / "recording.json").write_text(header)
    with pytest.raises(UavrlError, match=r"of the format uavrl.recording"):
        read_recording(folder)


def test_another_version_or_width_is_refused(folder: Path) -> None:
    record(folder, episodes=2)
    with pytest.raises(UavrlError, match=r"states of 7 numbers in .* holds states of 6"):
        StateRecorder(folder, 7)
    header = json.loads((folder / "recording.json").read_text())
    (folder / "recording.json").write_text(json.dumps({**header, "version": 9}))
    with pytest.raises(UavrlError, match="got version 9"):
        read_recording(folder)


def test_a_truncated_copy_is_refused_by_the_reader(folder: Path) -> None:
    record(folder, episodes=4)
    path = folder / "states.f32"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(UavrlError, match="is truncated"):
        read_recording(folder)
    path.unlink()
    with pytest.raises(UavrlError, match="the file holds 0"):
        read_recording(folder)


@pytest.mark.parametrize("rows", ["0,3,landed\n", "0,x,arrived\n", "1,3,arrived\n", "0,0,arrived\n", "0,3\n"])
def test_damaged_rows_are_refused(folder: Path, rows: str) -> None:
    record(folder, episodes=2)
    (folder / "episodes.csv").write_text("episode,states,outcome\n" + rows)
    with pytest.raises(UavrlError, match="is damaged"):
        read_recording(folder)


def test_foreign_rows_are_refused(folder: Path) -> None:
    record(folder, episodes=2)
    (folder / "episodes.csv").write_text("a,b\n1,2\n")
    with pytest.raises(UavrlError, match="start with the columns"):
        read_recording(folder)
    (folder / "episodes.csv").unlink()
    with pytest.raises(UavrlError, match="found no such file"):
        read_recording(folder)


@pytest.mark.parametrize("left", [(), ("states.f32",), ("states.f32", "episodes.csv", "recording.json.partial")])
def test_an_interrupted_creation_can_be_repeated(folder: Path, left: tuple[str, ...]) -> None:
    folder.mkdir()
    for name in left:
        (folder / name).touch()
    recorder = StateRecorder(folder, WIDTH)
    recorder.add(np.ones((2, WIDTH)), "arrived")
    assert len(read_recording(folder)) == 2


def test_states_without_a_header_are_not_overwritten(folder: Path) -> None:
    record(folder, episodes=1)
    (folder / "recording.json").unlink()
    before = content(folder)
    with pytest.raises(UavrlError, match="found no such file"):
        StateRecorder(folder, WIDTH)
    assert content(folder) == before
