"""Statistics over seeds: interquartile mean, stratified bootstrap, tests between two groups, Holm's correction."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, isfinite
from typing import Any

import numpy as np
from scipy import stats

RESAMPLES = 10_000
EXACT = 50_000  # ways to split the seeds of two groups that are all tried: 9 against 9 have 48,620
_SPREAD = 1e-12  # standard deviations of rates below it are rounding


@dataclass(frozen=True)
class Interval:
    """A value with the ends of its 95 % interval; ``None`` where no interval can be given."""

    value: float
    low: float | None
    high: float | None


def iqm(scores: np.ndarray, axis: int | None = None) -> Any:
    """Interquartile mean: the mean of what is left when a quarter of the scores is cut off at each end.

    Fewer than four scores lose none, so that it is their mean.

    Args:
        scores: of any shape.
        axis: along which; all scores without one.

    Examples:
        >>> float(iqm(np.array([0.0, 0.5, 0.7, 1.0]))), float(iqm(np.array([0.25, 0.75])))
        (0.6, 0.5)
    """
    return stats.trim_mean(scores, 0.25, axis=axis)


def stratified_iqm(scores: np.ndarray, *, seed: int = 0) -> Interval:
    """Interquartile mean over seeds and tasks, with the percentile interval of a stratified bootstrap.

    Within each task the seeds are drawn anew with replacement, independently of the other tasks (Agarwal et al. 2021).

    Args:
        scores: ``[seeds, tasks]``.
        seed: of the bootstrap's draws.

    Returns:
        Without an interval where there is one seed.

    Examples:
        >>> stratified_iqm(np.array([[0.5], [0.5], [0.5]]))
        Interval(value=0.5, low=0.5, high=0.5)
    """
    scores = np.asarray(scores, dtype=float)
    if scores.ndim != 2 or not scores.size:
        raise ValueError(f"Expected scores [seeds, tasks], got the shape {scores.shape}.")
    value = float(iqm(scores))
    if len(scores) < 2:
        return Interval(value, None, None)

    def statistic(*tasks: np.ndarray, axis: int = -1) -> Any:
        return iqm(np.concatenate(tasks, axis=axis), axis=axis)

    found = stats.bootstrap(
        tuple(scores.T),
        statistic,
        n_resamples=RESAMPLES,
        method="percentile",
        random_state=np.random.default_rng(seed),
    ).confidence_interval
    return Interval(value, float(found.low), float(found.high))


@dataclass(frozen=True)
class Comparison:
    """Two groups' means over seeds against each other.

    Attributes:
        difference: first mean less second mean.
        welch: p of Welch's t test, two-sided; ``None`` where the seeds of both groups do not vary.
        permutation: p of the permutation test of the difference, two-sided; exact up to :data:`EXACT` ways to split
            the seeds, so up to 9 against 9, and from :data:`RESAMPLES` random ones beyond.
        least: the least p that the permutation test can give with so many seeds.
    """

    difference: float
    welch: float | None
    permutation: float
    least: float


def compare(first: Sequence[float], second: Sequence[float]) -> Comparison:
    """Tests whether two groups of seeds differ in their mean.

    Args:
        first: one score for each seed, at least two.
        second: likewise.

    Raises:
        ValueError: for a group of fewer than two seeds, about whose spread nothing is known.

    Examples:
        >>> compare([1.0, 2.0], [3.0, 4.0])  # doctest: +ELLIPSIS
        Comparison(difference=-2.0, welch=0.105..., permutation=0.333..., least=0.333...)
    """
    if min(len(first), len(second)) < 2:
        raise ValueError(f"Expected two seeds or more in each group, got {len(first)} and {len(second)}.")
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    varies = max(np.std(a), np.std(b)) > _SPREAD
    with warnings.catch_warnings():  # seeds that agree to the last digit are no loss of precision
        warnings.simplefilter("ignore", RuntimeWarning)
        welch = float(stats.ttest_ind(a, b, equal_var=False).pvalue) if varies else None
    ways = comb(len(a) + len(b), len(a))
    exact = ways <= EXACT
    found = stats.permutation_test(
        (a, b),
        lambda x, y, axis: np.mean(x, axis=axis) - np.mean(y, axis=axis),
        vectorized=True,
        n_resamples=ways if exact else RESAMPLES,
        random_state=np.random.default_rng(0),
    )
    return Comparison(
        difference=float(a.mean() - b.mean()),
        welch=welch if welch is not None and isfinite(welch) else None,
        permutation=float(found.pvalue),
        least=min(2 / (ways if exact else RESAMPLES + 1), 1.0),  # two sides
    )


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down correction: p values that hold for all comparisons together, in the order given.

    Examples:
        >>> holm([0.01, 0.04, 0.03])
        [0.03, 0.06, 0.06]
    """
    order = sorted(range(len(p_values)), key=lambda i: p_values[i])
    corrected, highest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(order):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[i]))
        corrected[i] = highest
    return corrected
