from __future__ import annotations

import copy

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from uavrl.buffers import TrajectoryHistory

SMALL = st.lists(st.tuples(st.integers(-3, 3), st.integers(-20, 20)), max_size=80)
LARGE = st.lists(st.tuples(st.integers(0, 2), st.integers(-(2**63), 2**63 - 1)), max_size=40)


def filled(pairs: list[tuple[int, int]]) -> TrajectoryHistory:
    history = TrajectoryHistory()
    for label, value in pairs:
        history.insert_and_rank(label, value)
    return history


@settings(max_examples=200, deadline=None)
@given(SMALL | LARGE)
def test_agrees_with_sorting_a_set_anew(pairs: list[tuple[int, int]]) -> None:
    history, naive = TrajectoryHistory(), {}
    for label, value in pairs:
        naive.setdefault(label, set()).add(value)
        assert history.insert_and_rank(label, value) == sorted(naive[label]).index(value)
    assert history.classes == sorted(naive)
    assert {label: history.values(label) for label in history.classes} == {k: sorted(v) for k, v in naive.items()}
    assert len(history) == sum(map(len, naive.values()))


@settings(max_examples=100, deadline=None)
@given(SMALL, st.integers(-3, 3), st.integers(-20, 20), st.integers(-20, 20))
def test_a_larger_value_never_ranks_lower(pairs: list[tuple[int, int]], label: int, one: int, other: int) -> None:
    low, high = sorted([one, other])
    history = filled([*pairs, (label, low), (label, high)])
    assert history.insert_and_rank(label, low) <= history.insert_and_rank(label, high)
    assert (history.insert_and_rank(label, low) == history.insert_and_rank(label, high)) == (low == high)


@settings(max_examples=100, deadline=None)
@given(st.data(), SMALL)
def test_the_order_of_insertion_does_not_change_the_history(data, pairs) -> None:
    one, other = filled(pairs), filled(data.draw(st.permutations(pairs)))
    for name, tensor in one.state_dict().items():
        assert torch.equal(tensor, other.state_dict()[name])


@settings(max_examples=100, deadline=None)
@given(SMALL | LARGE, SMALL)
def test_state_round_trip(pairs: list[tuple[int, int]], before: list[tuple[int, int]]) -> None:
    history, other = filled(pairs), filled(before)
    state = history.state_dict()
    assert all(tensor.dtype == torch.int64 and tensor.ndim == 1 for tensor in state.values())
    other.load_state_dict(state)
    assert other.classes == history.classes
    for label in history.classes:
        assert other.values(label) == history.values(label)
        assert other.insert_and_rank(label, 3) == history.insert_and_rank(label, 3)


def test_the_state_spelled_out() -> None:
    state = filled([(7, 4), (-1, 2), (7, -4), (7, 4)]).state_dict()
    assert {k: v.tolist() for k, v in state.items()} == {"labels": [-1, 7], "offsets": [0, 1, 3], "values": [2, -4, 4]}


@pytest.mark.parametrize(
    "damage",
    [
        {"offsets": [0, 2, 3]},
        {"offsets": [0, 1, 2]},
        {"offsets": [1, 1, 3]},
        {"offsets": [0, 3]},
        {"offsets": []},
        {"values": [2, 4, -4]},
        {"values": [2, 4, 4]},
        {"values": [2, 4]},
        {"labels": [7, 7]},
        {"labels": [7]},
    ],
)
def test_a_damaged_state_is_refused_and_nothing_changes(damage: dict[str, list[int]]) -> None:
    good = {"labels": [-1, 7], "offsets": [0, 1, 3], "values": [5, -4, 4]}
    history = filled([(0, 1)])
    with pytest.raises(ValueError, match="damaged"):
        history.load_state_dict({k: torch.tensor(v, dtype=torch.int64) for k, v in (good | damage).items()})
    assert (history.classes, history.values(0)) == ([0], [1])


def test_labels_are_integers_and_values_are_floored() -> None:
    history = TrajectoryHistory()
    assert [history.insert_and_rank(1, value) for value in (-0.5, -1, 3.9, 3)] == [0, 0, 1, 1]
    for label, value in ((0.0, 1), (0, "b"), ("a", 1)):
        with pytest.raises(TypeError):
            history.insert_and_rank(label, value)
    assert history.insert_and_rank(torch.tensor(2), torch.tensor(5)) == 0
    assert {label: history.values(label) for label in history.classes} == {1: [-1, 3], 2: [5]}


def test_can_be_inspected_and_copied() -> None:
    history = filled([(0, 1), (0, 2), (5, 1)])
    assert (len(history), history.values(9)) == (3, [])
    assert repr(history) == "TrajectoryHistory(classes=2, values=3)"
    history.values(0).append(8)
    copy.deepcopy(history).insert_and_rank(0, 0)
    assert history.values(0) == [1, 2]
