from __future__ import annotations

import math

import numpy as np
import pytest

from uavrl.evaluation.sequential import Comparison, evidence_above, has_exceeded, rate_bounds, stops_after


def test_the_bounds_of_one_success_in_one_trial_are_worked_out_by_hand() -> None:
    """The mixture gives one success the probability 1/2, so that p is kept while 1/2 / p < 20."""
    low, high = rate_bounds(1, 1, 0.05)
    assert low == pytest.approx(1 / 40) and high == 1.0
    assert rate_bounds(0, 1, 0.05) == (0.0, pytest.approx(39 / 40))


def test_the_bounds_keep_their_error_rate_however_often_one_looks() -> None:
    """Of 400 sequences of 300 trials, looked at after each, at most about 5 % ever exclude the truth."""
    rng = np.random.default_rng(0)
    known = {
        n: [rate_bounds(k, n, 0.05) for k in range(n + 1)] for n in (1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233, 300)
    }
    misses = 0
    for _ in range(400):
        sums = (rng.random(300) < 0.9).cumsum()
        misses += any(not known[n][sums[n - 1]][0] <= 0.9 <= known[n][sums[n - 1]][1] for n in known)
    assert misses <= 400 * 0.05


def test_bounds_narrow_with_trials_and_widen_with_certainty() -> None:
    widths = [np.diff(rate_bounds(n // 2, n, 0.05)).item() for n in (10, 100, 1000)]
    assert widths[0] > widths[1] > widths[2]
    assert np.diff(rate_bounds(50, 100, 0.001)).item() > widths[1]


def test_a_difference_is_that_of_the_rates_and_lies_within_its_bounds() -> None:
    found = Comparison.of("S" * 80 + "C" * 20, "S" * 60 + "T" * 40)
    low, high = found.bounds
    assert (found.won, found.lost, found.tasks) == (20, 0, 100)
    assert math.isclose(found.difference, 0.2) and 0 < low < 0.2 < high and found.better == "first"
    mirrored = Comparison(found.lost, found.won, found.tasks)
    assert mirrored.bounds == pytest.approx((-high, -low)) and mirrored.better == "second"


def test_the_verdict_is_that_of_the_tasks_in_which_the_policies_differ() -> None:
    """Tasks that end alike for both say how large the difference is, not which policy is better."""
    assert Comparison(12, 2, 20).better == Comparison(12, 2, 2000).better
    assert Comparison(3, 0, 10).better is None, "three of three is chance"


def test_it_stops_at_the_first_block_that_answers() -> None:
    ours, theirs = "S" * 100, "C" * 100
    stopped = stops_after(ours, theirs, block=5)
    assert stopped.tasks == next(n for n in range(5, 100, 5) if Comparison(n, 0, n).better)
    assert stops_after("SC" * 20, "CS" * 20, block=7).tasks == 40, "an unclear answer takes all tasks"


def test_outcomes_of_different_tasks_are_refused() -> None:
    with pytest.raises(ValueError, match="argument 2 is shorter"):
        Comparison.of("SS", "S")


def test_the_evidence_is_the_mean_likelihood_ratio_of_greater_rates() -> None:
    """Over rates drawn as Jeffreys' prior has them above the rate, integrated numerically."""
    angles = np.linspace(np.arcsin(np.sqrt(0.8)), np.pi / 2, 200_001)  # of the arcsine distribution, evenly
    rates = np.sin(angles) ** 2
    for successes, trials in ((0, 1), (3, 3), (17, 20), (40, 41)):
        ratios = (rates / 0.8) ** successes * ((1 - rates) / 0.2) ** (trials - successes)
        mean = (ratios[:-1] + ratios[1:]).sum() / 2 / (len(rates) - 1)
        assert evidence_above(successes, trials, 0.8) == pytest.approx(mean, rel=1e-6)
    assert evidence_above(0, 5000, 0.9) == 0.0


@pytest.mark.parametrize("true", [0.9, 0.7])
def test_the_evidence_is_expected_to_fall_while_the_rate_is_at_most_that(true: float) -> None:
    for trials in range(30):
        for successes in range(trials + 1):
            now = evidence_above(successes, trials, 0.9)
            after = [evidence_above(successes + won, trials + 1, 0.9) for won in (0, 1)]
            assert (1 - true) * after[0] + true * after[1] <= now * (1 + 1e-9)


def test_a_policy_that_learns_is_rarely_said_to_exceed_what_it_only_reaches() -> None:
    """Its rate grows to 0.9 and stays there: of 200 trainings at most 5 % are ended by that rate."""
    rng = np.random.default_rng(0)
    rates = np.minimum(0.9, np.linspace(0.5, 1.2, 20))
    wrong = sum(
        any(has_exceeded(0.9, looks[:end]) for end in range(1, 21))
        for looks in ([(int(rng.binomial(20, rate)), 20) for rate in rates] for _ in range(200))
    )
    assert wrong <= 200 * 0.05


def test_looks_from_before_the_policy_was_good_cost_some_tasks_but_do_not_count_for_ever() -> None:
    early = [(5, 20), (12, 20)]
    needed = next(count for count in range(100) if has_exceeded(0.9, [*early, *[(20, 20)] * count]))
    alone = next(count for count in range(100) if has_exceeded(0.9, [(20, 20)] * count))
    assert alone < needed <= alone + 3
    assert not has_exceeded(0.9, [])


@pytest.mark.parametrize(("worse", "tasks"), [(0, (60, 100)), (3, (80, 140)), (10, (100, 180))])
def test_a_policy_that_always_succeeds_needs_more_tasks_the_later_it_became_good(
    worse: int, tasks: tuple[int, int]
) -> None:
    for rate, needed in zip((0.9, 0.95), tasks, strict=True):
        looks = [(12, 20)] * worse
        while not has_exceeded(rate, looks):
            looks.append((20, 20))
        assert 20 * (len(looks) - worse) == needed
