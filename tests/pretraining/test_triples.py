"""Triples never cross the boundary of an episode."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavrl.pretraining import triple_centres


def test_on_an_example() -> None:
    assert triple_centres(np.array([0, 0, 0, 1, 1, 2, 2, 2, 2])).tolist() == [1, 6, 7]


@pytest.mark.parametrize("episode", [[], [0], [0, 0], [0, 1, 2]])
def test_without_three_states_in_a_row_there_is_none(episode: list[int]) -> None:
    assert triple_centres(np.array(episode, np.int32)).tolist() == []


def test_the_first_and_last_state_are_no_centres() -> None:
    """Index -1 would wrap around to the end of the recording."""
    assert triple_centres(np.zeros(4, np.int32)).tolist() == [1, 2]


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(1, 7), min_size=1, max_size=30))
def test_triples_stay_in_their_episode_and_none_is_missing(lengths: list[int]) -> None:
    episode = np.repeat(np.arange(len(lengths)), lengths)
    centres = triple_centres(episode)
    assert all(episode[t - 1] == episode[t] == episode[t + 1] for t in centres)
    assert len(centres) == sum(max(length - 2, 0) for length in lengths)
    assert len(set(centres.tolist())) == len(centres)


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\[N\]"):
        triple_centres(np.zeros((3, 1)))
