"""LifeGuard's arithmetic as pure tensor functions (Chansuparp (2022), §3.5)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


def lifeguard_penalty(probability: Tensor, weight: Tensor | float) -> Tensor:
    """Chansuparp (2022), Eq. 3.11: what the actor's objective ``-(Q - p_cp c)`` has beyond ``-Q``: ``p_cp c``.

    Args:
        probability: c(o, μ(s)), ``[*B]``.
        weight: p_cp, a scalar.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: for a weight that is not a scalar.

    Examples:
        >>> lifeguard_penalty(torch.tensor([0.0, 0.5, 1.0]), 10.0).tolist()
        [0.0, 5.0, 10.0]
    """
    if isinstance(weight, Tensor) and weight.ndim:
        raise ValueError(f"Expected one weight for all samples, got {tuple(weight.shape)}.")
    return probability * weight


def annealed_weight(penalty_weight: float, successes: Tensor) -> float:
    """``p_cp (1 - clip(success, 0, 1))``: the better the recent episodes, the less LifeGuard says.

    Args:
        penalty_weight: p_cp.
        successes: 1 for each recent episode that arrived, else 0, ``[N]``; with N = 0 the rate is 0.

    Examples:
        >>> annealed_weight(10.0, torch.tensor([1.0, 0.0, 0.0, 0.0])), annealed_weight(10.0, torch.zeros(0))
        (7.5, 10.0)
    """
    rate = float(successes.double().mean()) if len(successes) else 0.0
    return penalty_weight * (1.0 - min(max(rate, 0.0), 1.0))


def confusion_counts(predicted: Tensor, actual: Tensor) -> Tensor:
    """Counts true positives, false positives, true negatives and false negatives; a collision is positive.

    Args:
        predicted: bool ``[N]``.
        actual: bool ``[N]``.

    Returns:
        int64 ``[4]``.

    Raises:
        ValueError: for other shapes or types.

    Examples:
        >>> t = torch.tensor
        >>> confusion_counts(t([True, True, False, False, False]), t([True, False, False, False, True])).tolist()
        [1, 1, 2, 1]
    """
    if predicted.shape != actual.shape or predicted.ndim != 1 or {predicted.dtype, actual.dtype} != {torch.bool}:
        raise ValueError(
            f"Expected two bool vectors of one length, got {tuple(predicted.shape)} {predicted.dtype} and "
            f"{tuple(actual.shape)} {actual.dtype}."
        )
    cells = (predicted & actual, predicted & ~actual, ~predicted & ~actual, ~predicted & actual)
    return torch.stack([cell.sum() for cell in cells])


class ConfusionRates(NamedTuple):
    """Shares of the actual positives or negatives; 0 where there are none."""

    true_positive: float
    false_positive: float
    true_negative: float
    false_negative: float


def confusion_rates(counts: Tensor) -> ConfusionRates:
    """Rates over several evaluations.

    Args:
        counts: ``[E, 4]``, rows of `confusion_counts`.

    Examples:
        >>> [round(rate, 2) for rate in confusion_rates(torch.tensor([[1, 1, 2, 1], [3, 0, 1, 1]]))]
        [0.67, 0.25, 0.75, 0.33]
    """
    tp, fp, tn, fn = counts.sum(0).tolist()
    positives, negatives = max(tp + fn, 1), max(tn + fp, 1)
    return ConfusionRates(tp / positives, fp / negatives, tn / negatives, fn / positives)


def is_trusted(counts: Tensor, evaluations: int, min_evaluations: int, min_true_negative_rate: float) -> bool:
    """The actor listens after more than ``min_evaluations`` evaluations, while the true-negative rate exceeds a limit.

    Args:
        counts: ``[E, 4]``, `confusion_counts` of the last evaluations.
        evaluations: how many there ever were.
        min_evaluations: how many are not enough.
        min_true_negative_rate: the rate that is not enough.

    Examples:
        >>> counts = torch.tensor([[50, 1, 49, 0]])
        >>> is_trusted(counts, 21, 20, 0.96), is_trusted(counts, 20, 20, 0.96), is_trusted(counts, 21, 20, 0.98)
        (True, False, False)
    """
    return evaluations > min_evaluations and confusion_rates(counts).true_negative > min_true_negative_rate
