"""States of a run, from the replay buffer of its newest checkpoint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.states import OUTCOMES, checkpoint_run, walk
from uavrl.errors import UavrlError
from uavrl.pretraining import read_states, triple_centres

WIDTH = 6


def episodes(count: int = 7, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [walk(int(rng.integers(3, 9)), WIDTH, rng) for _ in range(count)]


def test_the_buffer_of_a_checkpoint_gives_the_states_in_order(tmp_path: Path) -> None:
    written = episodes()
    path = checkpoint_run(tmp_path / "run", written)
    found = read_states(tmp_path / "run")
    assert np.array_equal(found.states, np.concatenate(written))
    assert found.states.dtype == np.float32
    assert found.episode.tolist() == [i for i, states in enumerate(written) for _ in states]
    assert found.outcomes == [OUTCOMES[i % 3] for i in range(7)]
    assert found.name == f"run/checkpoints/{path.name}"


@pytest.mark.parametrize("capacity", [12, 17, 18, 24, 29])
def test_of_a_buffer_that_overwrote_its_oldest_transitions_whole_episodes_are_left(
    tmp_path: Path, capacity: int
) -> None:
    written = episodes(9)
    checkpoint_run(tmp_path / "run", written, capacity)
    found = read_states(tmp_path / "run")
    count = len(found.outcomes)
    assert count >= 1
    assert np.array_equal(found.states, np.concatenate(written[-count:]))
    assert found.outcomes == [OUTCOMES[i % 3] for i in range(9)][-count:]
    kept = sum(len(states) for states in written[-count - 1 :])
    assert kept >= capacity or kept == sum(map(len, written))  # one more would not have fitted


def test_the_states_of_a_run_may_be_stacked(tmp_path: Path) -> None:
    frames = [np.arange(10 * i, 10 * i + steps + 3, dtype=np.float32)[:, None] for i, steps in enumerate((5, 1, 8))]
    written = [np.lib.stride_tricks.sliding_window_view(f[:, 0], 3).copy() for f in frames]  # one state more than steps
    checkpoint_run(tmp_path / "run", [states[:-1] for states in written], frames=3)  # each next state is one higher
    assert np.array_equal(read_states(tmp_path / "run").states, np.concatenate([states[:-1] for states in written]))


def test_transitions_of_several_steps_end_where_their_episodes_did(tmp_path: Path) -> None:
    written = episodes()
    checkpoint_run(tmp_path / "run", written, n_steps=3)  # the last three of each episode are done
    found = read_states(tmp_path / "run")
    assert np.array_equal(found.states, np.concatenate(written))
    assert np.bincount(found.episode).tolist() == [len(states) for states in written]
    assert found.outcomes == [OUTCOMES[i % 3] for i in range(7)]


def test_a_missing_run_checkpoint_or_episode_is_named(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    checkpoint_run(tmp_path / "run", [])
    for name, message in (("none", "a run folder at"), ("empty", "a checkpoint in"), ("run", "whole episodes")):
        with pytest.raises(UavrlError, match=f"Expected {message}"):
            read_states(tmp_path / name)


def test_a_damaged_checkpoint_is_named(tmp_path: Path) -> None:
    path = checkpoint_run(tmp_path / "run", episodes())
    content = path.read_bytes()
    start = content.index(episodes()[0][0].tobytes())
    path.write_bytes(content[:start] + b"\x07" + content[start + 1 :])
    with pytest.raises(UavrlError, match=r"is damaged .*fails its checksum"):
        read_states(tmp_path / "run")
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(UavrlError, match="damaged"):
        read_states(tmp_path / "run")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_states_that_are_not_finite_are_refused(tmp_path: Path, value: float) -> None:
    written = episodes()
    written[3][1, 2] = value
    checkpoint_run(tmp_path / "run", written)
    with pytest.raises(UavrlError, match=r"Expected finite states in .*run"):
        read_states(tmp_path / "run")


def test_a_perception_that_is_no_mapping_is_refused(tmp_path: Path) -> None:
    checkpoint_run(tmp_path / "run", episodes(), perception="folded")
    with pytest.raises(UavrlError, match=r"Expected perception in .* to be a mapping, got 'folded'"):
        read_states(tmp_path / "run")


@pytest.mark.parametrize("episode", [[], [0], [0, 0], [0, 1, 2]])
def test_without_three_states_in_a_row_there_is_no_triple(episode: list[int]) -> None:
    assert triple_centres(np.array(episode, np.int32)).tolist() == []


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(1, 7), min_size=1, max_size=30))
def test_triples_stay_in_their_episode_and_none_is_missing(lengths: list[int]) -> None:
    episode = np.repeat(np.arange(len(lengths)), lengths)
    centres = triple_centres(episode)
    assert all(0 < t < len(episode) - 1 for t in centres), "-1 would wrap around to the end"
    assert all(episode[t - 1] == episode[t] == episode[t + 1] for t in centres)
    assert len(centres) == sum(max(length - 2, 0) for length in lengths)
    assert len(set(centres.tolist())) == len(centres)
    with pytest.raises(ValueError, match=r"\[N\]"):
        triple_centres(episode[:, None])
