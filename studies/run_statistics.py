"""Statistics of runs that differ in their seeds, and the files that such runs are kept in."""

from __future__ import annotations

import gzip
import math
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple, TextIO

import numpy as np
from scipy.stats import trim_mean

from uavrl.errors import UavrlError
from uavrl.reporting.learning_curves import moving_mean
from uavrl.runs.episodes import wilson

RESAMPLES = 10_000
FEWEST = 5  # seeds, for an interval


class Flights(NamedTuple):
    """The flights of one run up to a horizon: steps of each, and how it ended."""

    steps: np.ndarray
    ends: np.ndarray

    def share(self, end: str, last: int | None = None) -> float:
        """Of flights that ended so, in %; of the ``last`` ones or of all."""
        return 100 * float((self.ends[-last if last else None :] == end).mean())

    def until(self, success: float, window: int) -> float:
        """Thousand steps until so many of the last ``window`` flights arrived; infinite where it never happened."""
        rates = moving_mean(self.ends == "a", window)[window - 1 :]
        reached = np.flatnonzero(rates >= success - 1e-9)
        return float(self.steps.cumsum()[reached[0] + window - 1]) / 1000 if len(reached) else float("inf")

    def steps_per_arrival(self, last: int) -> float:
        """Mean length of the arriving ones among the last flights."""
        arrived = self.steps[-last:][self.ends[-last:] == "a"]
        return float(arrived.mean()) if len(arrived) else float("nan")


def cut(run: dict[str, Any], flights: int | None, steps: int | None) -> Flights:
    """A run up to the horizon."""
    length, ends = np.array(run["steps"]), np.array(list(run["ends"]))
    most = len(ends) if steps is None else int(np.searchsorted(length.cumsum(), steps, side="right"))
    enough = length.sum() >= (steps or 0) and len(ends) >= (flights or 0)
    if not enough:
        raise UavrlError(f"Seed {run['seed']} flew {len(ends):,} flights or {length.sum():,} steps: too few for that.")
    most = min(most, flights or most)
    return Flights(length[:most], ends[:most])


def iqm(values: np.ndarray) -> np.ndarray:
    """The interquartile mean over the last axis; the median where one of them is infinite."""
    return trim_mean(values, 0.25, axis=-1) if np.isfinite(values).all() else np.median(values, axis=-1)


def difference(method: np.ndarray, baseline: np.ndarray) -> tuple[float, float, float]:
    """Of the interquartile means, with its 95 % interval over resampled seeds."""
    rng = np.random.default_rng(0)
    means = [iqm(rng.choice(values, (RESAMPLES, len(values)))) for values in (method, baseline)]
    low, high = np.quantile(means[0] - means[1], [0.025, 0.975])
    return float(iqm(method) - iqm(baseline)), float(low), float(high)


def named_folder(pair: str) -> tuple[str, Path]:
    """Name and folder of ``NAME=FOLDER``, where both may hold an equals sign."""
    for place, sign in enumerate(pair):
        if sign == "=" and (folder := Path(pair[place + 1 :])).is_dir():
            return pair[:place], folder
    raise UavrlError(f"Expected NAME=FOLDER with a folder that exists, got {pair!r}: write the folder's path.")


def opened(path: Path, mode: Literal["rt", "wt"]) -> TextIO:
    """A text file, which is compressed where its name ends in .gz."""
    if path.suffix == ".gz":
        return gzip.open(path, mode, newline="", encoding="utf-8")
    return path.open(mode, newline="", encoding="utf-8")


def difference_of_rates(one: Mapping[str, float], other: Mapping[str, float]) -> tuple[float, float, float]:
    """Of two rates of ``wilson``, with its 95 % interval: the difference, its lower and its upper end.

    Source: Newcombe (1998), Interval estimation for the difference between independent proportions, method 10.
    """
    found = one["rate"] - other["rate"]
    below = math.hypot(one["rate"] - one["low"], other["high"] - other["rate"])
    above = math.hypot(one["high"] - one["rate"], other["rate"] - other["low"])
    return found, found - below, found + above


def paired_difference(ours: str, theirs: str) -> tuple[float, float, float]:
    """By how many points one of two policies that flew the same tasks succeeds more often, with its 95 % interval.

    Source: Newcombe (1998), Improved confidence intervals for the difference between binomial proportions based on
    paired data, method 10: Wilson's intervals, and the correlation of the outcomes with a correction for continuity.

    Args:
        ours: how each task ended, a letter each, ``S`` for success.
        theirs: likewise.
    """
    pairs, count = [(a == "S", b == "S") for a, b in zip(ours, theirs, strict=True)], len(ours)
    both, first, second, neither = (pairs.count(pair) for pair in product((True, False), repeat=2))
    one, other = wilson(both + first, count), wilson(both + second, count)
    spread = math.sqrt((both + first) * (second + neither) * (both + second) * (first + neither))
    linked = both * neither - first * second
    linked = max(linked - count / 2, 0) if linked > 0 else linked
    share = linked / spread if spread else 0.0
    found = one["rate"] - other["rate"]
    below, above = one["rate"] - one["low"], other["high"] - other["rate"]
    least = math.sqrt(below**2 - 2 * share * below * above + above**2)
    below, above = one["high"] - one["rate"], other["rate"] - other["low"]
    most = math.sqrt(below**2 - 2 * share * below * above + above**2)
    return 100 * found, 100 * (found - least), 100 * (found + most)
