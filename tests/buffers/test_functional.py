from __future__ import annotations

import pytest
import torch

from uavrl.buffers import TrajectoryHistory, backward_reward
from uavrl.buffers.functional import window_ends, window_sums

# Ten steps: three windows, and a tail of one step that gets nothing.
REWARD = [1.0, 2.0, 0.5, 0.5, 0.25, 1.5, 2.0, 3.0, 1.0, 50.0]
LABELS = [4, 9, 4]


class TestAlgorithm31:
    """Literal numbers worked out by hand, p_frames = 3, p_addReward = 0.2.

    k = 1, Z = 3, class 4: 1 + 2 + 0.5 = 3.5, R = 3.
    k = 2, Z = 6, class 9: 0.5 + 0.25 + 1.5 = 2.25, R = 2.
    k = 3, Z = 9, class 4: 2 + 3 + 1 = 6, R = 6.
    """

    def test_two_episodes(self) -> None:
        """The second episode meets what the first left.

        First: H_4 = (3): m = 0. H_9 = (2): m = 0. H_4 = (3, 6): m = 1, so steps 7 to 9 earn 0.2 more.

        Second, worse in its first window: 0.5 + 0.5 + 0.5 = 1.5, R = 1, H_4 = (1, 3, 6): m = 0.
        Its second is as before: R = 2 is known, H_9 = (2): m = 0.
        Its third, 6 again, is known, but H_4 = (1, 3, 6) by now: m = 2, so steps 7 to 9 earn 0.4 more.
        """
        history = TrajectoryHistory()
        first = backward_reward(torch.tensor(REWARD), torch.tensor(LABELS), history)
        assert torch.equal(first, torch.tensor([1.0, 2.0, 0.5, 0.5, 0.25, 1.5, 2.2, 3.2, 1.2, 50.0]))
        assert (history.values(4), history.values(9)) == ([3, 6], [2])
        second = backward_reward(torch.tensor([0.5, 0.5, 0.5, *REWARD[3:]]), torch.tensor(LABELS), history)
        assert torch.equal(second, torch.tensor([0.5, 0.5, 0.5, 0.5, 0.25, 1.5, 2.4, 3.4, 1.4, 50.0]))
        assert (history.values(4), history.values(9)) == ([1, 3, 6], [2])

    def test_the_same_episode_twice(self) -> None:
        """First: m = 0, 0, 1. Second: R = 3, 2, 6 are all known, their places are 0, 0, 1 again."""
        history, reward, labels = TrajectoryHistory(), torch.tensor(REWARD), torch.tensor(LABELS)
        first, second = (backward_reward(reward, labels, history) for _ in range(2))
        assert torch.equal(first, second)
        assert len(history) == 3

    def test_one_class_and_sums_below_zero(self) -> None:
        """One class, R = -2, -2, 1: the floor of -1.5 is -2; equal sums share a place: m = 0, 0, 1.

        A better episode, R = 4, 0, -6: H = (-2, 1, 4): m = 2; (-2, 0, 1, 4): m = 1; (-6, -2, 0, 1, 4): m = 0.
        """
        history, labels = TrajectoryHistory(), torch.zeros(3, dtype=torch.int64)
        first = torch.tensor([-0.5, -0.5, -0.5, -2.0, 0.0, 0.0, 0.5, 0.5, 0.5])
        second = torch.tensor([4.5, 0.0, 0.0, 0.0, 0.0, 0.9, -2.0, -2.0, -2.0])
        extra = backward_reward(first, labels, history, multiplier=1.0) - first
        assert extra.tolist() == [0, 0, 0, 0, 0, 0, 1, 1, 1]
        extra = backward_reward(second, labels, history, multiplier=1.0) - second
        torch.testing.assert_close(extra, torch.tensor([2.0, 2, 2, 1, 1, 1, 0, 0, 0]))
        assert history.values(0) == [-6, -2, 0, 1, 4]


def test_windows() -> None:
    """Steps 3, 6, 9 … ≤ T, counted from 1."""
    expected = {0: [], 2: [], 3: [2], 5: [2], 6: [2, 5], 9: [2, 5, 8], 10: [2, 5, 8]}
    assert {steps: window_ends(steps).tolist() for steps in expected} == expected
    assert window_ends(10, 4).tolist() == [3, 7]
    assert window_ends(3, 1).tolist() == [0, 1, 2]
    with pytest.raises(ValueError, match="frames=0"):
        window_ends(10, 0)


def test_sums_are_exact_where_floats_are_not() -> None:
    """In float32 2^24 + 0.5 + 0.5 is 2^24."""
    assert window_sums(torch.tensor([2.0**24, 0.5, 0.5])).tolist() == [2**24 + 1]


def test_an_episode_shorter_than_a_window_stays() -> None:
    history, reward = TrajectoryHistory(), torch.tensor([1.0, 9.0])
    assert torch.equal(backward_reward(reward, torch.empty(0, dtype=torch.int64), history), reward)
    assert len(history) == 0


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_given_rewards_stay_and_so_does_their_type(dtype: torch.dtype) -> None:
    reward = torch.tensor(REWARD, dtype=dtype)
    new = backward_reward(reward, torch.tensor(LABELS), TrajectoryHistory())
    assert new.dtype == dtype
    assert reward.tolist() == REWARD


@pytest.mark.parametrize(
    ("reward", "labels", "message"),
    [
        (torch.ones(2, 3), torch.tensor([0]), r"Expected the rewards of one episode, floats \[T\]"),
        (torch.ones(3, dtype=torch.int64), torch.tensor([0]), "got torch.int64"),
        (torch.ones(3), torch.tensor([0, 1]), r"each window, \[1\], got torch.int64 \[2\]"),
        (torch.ones(3), torch.tensor([0.0]), "got torch.float32"),
        (torch.ones(3), torch.tensor([True]), "got torch.bool"),
        (torch.ones(3), [0], "got list"),
        (torch.tensor([1.0, torch.nan, 1.0]), torch.tensor([0]), "finite rewards"),
        (torch.tensor([1.0, torch.inf, 1.0]), torch.tensor([0]), "finite rewards"),
    ],
)
def test_bad_input_is_refused_and_the_history_stays(reward, labels, message: str) -> None:
    history = TrajectoryHistory()
    with pytest.raises(ValueError, match=message):
        backward_reward(reward, labels, history)
    assert len(history) == 0
