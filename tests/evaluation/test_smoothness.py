"""How smooth some actions are, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from uavrl.evaluation.smoothness import action_change, smoothness_texts, summarize_smoothness, yaw_reversals


def turning(*rates: float) -> np.ndarray:
    return np.array([[2.0, 0.0, 0.0, rate] for rate in rates])


def test_the_change_is_the_mean_of_each_component_by_itself() -> None:
    actions = np.array([[2.0, 0.0, -1.0, 0.5], [1.0, 0.0, 1.0, -0.5], [1.5, 0.25, 1.0, -0.5]])
    assert action_change(actions) == [0.75, 0.125, 1.0, 0.5]
    assert action_change(np.array([[1.0], [-1.0]])) == [2.0]


@pytest.mark.parametrize(
    ("rates", "share"),
    [
        ((1.0, -1.0, 1.0, -1.0), 1.0),
        ((1.0, 1.0, 1.0), 0.0),
        ((1.0, 0.0, -1.0), 0.0),  # it stops turning between the two
        ((0.051, -0.051, -2.0), 0.5),
        ((0.05, -2.0, 0.05, -2.0), 0.0),  # 0.05 rad/s is negligible
        ((-2.0, 2.0, 2.0, 2.0, 2.0), 0.25),
    ],
)
def test_a_reversal_has_opposite_yaw_rates_of_some_size_before_and_after(
    rates: tuple[float, ...], share: float
) -> None:
    assert yaw_reversals(turning(*rates)) == share


def test_one_step_has_neither() -> None:
    assert action_change(turning(1.0)) is None and yaw_reversals(turning(1.0)) is None


def test_long_episodes_count_for_more_and_what_is_not_known_is_left_out() -> None:
    found = summarize_smoothness([11, 31, 1, 5], [[0.4, 2.0], [0.8, 0.0], None, None], [0.5, 0.1, None, None])
    assert found["action_change"] == pytest.approx([0.7, 0.5]) and found["yaw_reversals"] == pytest.approx(0.2)
    assert summarize_smoothness([5], [[1.0, 2.0]], [None]) == {"action_change": [1.0, 2.0]}
    assert summarize_smoothness([5], [None], [None]) == {} and smoothness_texts(None, None) == {}
