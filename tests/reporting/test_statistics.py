from __future__ import annotations

import warnings

import numpy as np
import pytest

from uavrl.reporting.statistics import compare, holm, iqm, stratified_iqm
from uavrl.training.episodes import wilson


def test_wilson_by_hand() -> None:
    # z = 1.959964: centre (0.5 + z²/20) / (1 + z²/10) = 0.5, half width z √(0.025 + z²/400) / (1 + z²/10) = 0.26341
    assert wilson(5, 10) == pytest.approx({"rate": 0.5, "low": 0.23659, "high": 0.76341}, abs=1e-5)
    # z²/(n + z²) = 3.841459 / 13.841459
    assert wilson(0, 10) == pytest.approx({"rate": 0.0, "low": 0.0, "high": 0.277533}, abs=1e-6)


def test_the_interquartile_mean_cuts_a_quarter_off_at_each_end() -> None:
    assert iqm(np.array([9.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 100.0])) == pytest.approx((3 + 4 + 5 + 6) / 4)
    assert iqm(np.array([[0.0, 0.5], [0.7, 1.0]])) == pytest.approx(0.6)


def test_two_seeds_give_themselves_as_the_ends_of_the_interval() -> None:
    found = stratified_iqm(np.array([[0.25], [0.75]]))
    assert (found.value, found.low, found.high) == (0.5, 0.25, 0.75)


def test_the_bootstrap_draws_within_each_task() -> None:
    # Seeds agree on each task and tasks differ: nothing varies when seeds are drawn within a task.
    found = stratified_iqm(np.array([[0.2, 0.8], [0.2, 0.8], [0.2, 0.8]]))
    assert found.value == pytest.approx(0.5)
    assert found.low == pytest.approx(0.5) and found.high == pytest.approx(0.5)


def test_one_seed_has_no_interval() -> None:
    found = stratified_iqm(np.array([[0.3]]))
    assert (found.value, found.low, found.high) == (pytest.approx(0.3), None, None)


def test_the_bootstrap_repeats_itself() -> None:
    scores = np.array([[0.1], [0.4], [0.5], [0.9], [0.3]])
    assert stratified_iqm(scores) == stratified_iqm(scores)


def test_two_against_two_seeds() -> None:
    # t = -2 / √(0.5/2 + 0.5/2) = -2.828, two degrees of freedom: p = 1 - |t| / √(t² + 2) = 0.10557
    found = compare([1.0, 2.0], [3.0, 4.0])
    assert found.welch == pytest.approx(0.105573, abs=1e-6)
    # Six ways to split four seeds, and the two most extreme ones are as far apart.
    assert found.permutation == pytest.approx(2 / 6) and found.least == pytest.approx(2 / 6)


@pytest.mark.parametrize(("first", "second"), [(2, 3), (3, 3), (5, 5), (4, 6), (9, 9)])
def test_no_permutation_p_is_below_the_least(first: int, second: int) -> None:
    found = compare(list(np.arange(first)), list(np.arange(second) + 100.0))
    assert found.permutation == pytest.approx(found.least)


@pytest.mark.parametrize(("seeds", "least"), [(8, 2 / 12_870), (9, 2 / 48_620), (10, 2 / 10_001)])
def test_the_permutation_test_is_exact_up_to_nine_against_nine(seeds: int, least: float) -> None:
    assert compare(list(np.arange(seeds)), list(np.arange(seeds) + 100.0)).least == pytest.approx(least)


def test_seeds_that_do_not_vary_have_no_t_test() -> None:
    found = compare([0.5, 0.5], [0.5, 0.5])
    assert (found.difference, found.welch, found.permutation) == (0.0, None, 1.0)
    assert compare([0.5, 0.5], [0.9, 0.9]).welch is None


def test_one_seed_is_not_tested() -> None:
    with pytest.raises(ValueError, match="two seeds or more"):
        compare([0.5], [0.1, 0.2])


def test_holm_by_hand() -> None:
    # 0.01 · 4, then 0.02 · 3 = 0.06, then 0.03 · 2 = 0.06, then max(0.04, 0.06)
    assert holm([0.04, 0.01, 0.03, 0.02]) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_seeds_that_agree_are_compared_in_silence() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = compare([0.874, 0.874], [0.97, 0.986])
    assert found.welch is not None and 0.04 < found.welch < 0.06
