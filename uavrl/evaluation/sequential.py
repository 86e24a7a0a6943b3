"""Compares two policies task by task, or one with a success rate, and may stop as soon as the answer is clear.

A confidence sequence holds at every number of tasks at once, so that looking after each task and stopping at will keep
the error rate. Sources: Robbins (1970), Statistical methods related to the law of the iterated logarithm, for the
mixture; Ramdas et al. (2023), Game-theoretic statistics and safe anytime-valid inference, for its use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import betainc, betaln, xlogy

ERROR = 0.05
SHARE_OF_RATE = (
    0.2  # of the error rate, spent on how often the policies differ; the rest on which of them succeeds then
)


def rate_bounds(successes: int, trials: int, error: float) -> tuple[float, float]:
    """Return a confidence sequence for a rate: bounds that hold at every number of trials with probability 1 - error.

    It keeps each rate ``p`` against which the likelihood ratio of Jeffreys' mixture, a martingale that starts at 1, is
    below ``1 / error``: by Ville's inequality it ever reaches that with a probability of at most ``error``.

    Args:
        successes: how many of the trials so far succeeded.
        trials: how many there were.
        error: probability in (0, 1) that the bounds ever exclude the true rate.

    Examples:
        >>> rate_bounds(0, 0, 0.05)
        (0.0, 1.0)
        >>> [round(bound, 3) for bound in rate_bounds(9, 10, 0.05)]
        [0.456, 1.0]
    """
    failures = trials - successes
    mixture = betaln(successes + 0.5, failures + 0.5) - betaln(0.5, 0.5)

    def excess(rate: float) -> float:
        return float(mixture - xlogy(successes, rate) - xlogy(failures, 1 - rate) + np.log(error))

    likeliest, edge = successes / max(trials, 1), 1e-12
    low = 0.0 if excess(edge) <= 0 else brentq(excess, edge, max(likeliest, edge))
    high = 1.0 if excess(1 - edge) <= 0 else brentq(excess, min(likeliest, 1 - edge), 1 - edge)
    return low, high


def evidence_above(successes: int, trials: int, rate: float) -> float:
    """Return how much likelier the outcomes are under greater success rates than under ``rate``.

    The greater rates are weighted as Jeffreys' prior weights them. While every trial succeeds with a probability of at
    most ``rate``, which may change from trial to trial, this is a supermartingale that starts at 1: it ever reaches
    ``1 / error`` with a probability of at most ``error`` (Ville's inequality).

    Args:
        successes: how many of the trials so far succeeded.
        trials: how many there were.
        rate: success rate in (0, 1).

    Examples:
        >>> evidence_above(0, 0, 0.9)
        1.0
        >>> round(evidence_above(60, 60, 0.9)), round(evidence_above(54, 60, 0.9), 2)
        (197, 0.24)
    """
    failures = trials - successes
    above = betainc([failures + 0.5, 0.5], [successes + 0.5, 0.5], 1 - rate)  # shares of the rates above, by symmetry
    if above[0] == 0:  # far fewer successes than that
        return 0.0
    mixture = betaln(successes + 0.5, failures + 0.5) - betaln(0.5, 0.5) + np.log(above[0]) - np.log(above[1])
    return float(np.exp(min(mixture - xlogy(successes, rate) - xlogy(failures, 1 - rate), 700.0)))


def has_exceeded(rate: float, looks: Sequence[tuple[int, int]], error: float = ERROR) -> bool:
    """Whether a policy that goes on learning has come to succeed more often than ``rate``.

    The evidence since the first look, since the second one and so on is weighted by 1/2, 1/6, 1/12 …, which add up to
    1: outcomes from the time when the policy was worse do not count for ever. If the policy never succeeds more often
    than ``rate``, this is ever true with a probability of at most ``error``, however often one looks.

    Args:
        rate: success rate in (0, 1).
        looks: successes and trials of each look, in their order.
        error: probability of a wrong yes.

    Examples:
        >>> has_exceeded(0.9, [(20, 20)] * 2), has_exceeded(0.9, [(20, 20)] * 3), has_exceeded(0.9, [(18, 20)] * 50)
        (False, True, False)
    """
    evidence, successes, trials = 0.0, 0, 0
    for first in range(len(looks), 0, -1):
        successes, trials = successes + looks[first - 1][0], trials + looks[first - 1][1]
        evidence += evidence_above(successes, trials, rate) / (first * (first + 1))
    return evidence >= 1 / error


@dataclass(frozen=True)
class Comparison:
    """How two policies did in the same tasks.

    Args:
        won: tasks in which only the first policy succeeded.
        lost: tasks in which only the second one succeeded.
        tasks: all tasks.
        error: probability that the bounds ever exclude the true difference, however often one looks.

    Examples:
        >>> Comparison.of("SSSSSSSSSSSSCS", "CCCCCCCCCCCCCS")
        Comparison(won=12, lost=0, tasks=14, error=0.05)
        >>> Comparison.of("SSSSSSSSSSSSCS", "CCCCCCCCCCCCCS").better
        'first'
        >>> Comparison.of("SC", "CS").better is None
        True
    """

    won: int
    lost: int
    tasks: int
    error: float = ERROR

    @classmethod
    def of(cls, ours: Sequence[str], theirs: Sequence[str], error: float = ERROR) -> Comparison:
        """Compare the outcomes of the same tasks, a letter each, ``S`` for a success.

        Raises:
            ValueError: if one policy flew more tasks than the other.
        """
        pairs = [(a == "S", b == "S") for a, b in zip(ours, theirs, strict=True)]
        return cls(pairs.count((True, False)), pairs.count((False, True)), len(pairs), error)

    @property
    def difference(self) -> float:
        """The first policy's success rate less the second one's, in [-1, 1]."""
        return (self.won - self.lost) / max(self.tasks, 1)

    @property
    def bounds(self) -> tuple[float, float]:
        """The bounds of the difference.

        The policies differ in a share ``r`` of the tasks, and the first one wins a share ``w`` of these: the difference
        is ``r (2 w - 1)``. Each share has its confidence sequence, and the two have the error rate together.
        """
        split = self.won + self.lost
        least, most = rate_bounds(split, self.tasks, SHARE_OF_RATE * self.error)
        low, high = (2 * w - 1 for w in rate_bounds(self.won, split, (1 - SHARE_OF_RATE) * self.error))
        return low * (most if low < 0 else least), high * (most if high > 0 else least)

    @property
    def better(self) -> str | None:
        """``"first"`` or ``"second"``, or None while the bounds include no difference."""
        low, high = self.bounds
        return "first" if low > 0 else "second" if high < 0 else None


def stops_after(ours: Sequence[str], theirs: Sequence[str], block: int, error: float = ERROR) -> Comparison:
    """Compare two policies block by block, and stop when one is better.

    Args:
        ours: outcomes of the first policy in the order of the tasks, a letter each, ``S`` for a success.
        theirs: outcomes of the second policy in the same tasks.
        block: number of tasks between two looks.
        error: probability of a wrong verdict.

    Returns:
        The comparison of the tasks up to the first clear answer, or of all.
    """
    found = Comparison(0, 0, 0, error)
    for end in range(block, len(ours) + block, block):
        found = Comparison.of(ours[:end], theirs[:end], error)
        if found.better:
            break
    return found
