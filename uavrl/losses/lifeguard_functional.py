"""LifeGuard's arithmetic as pure tensor functions (Chansuparp (2022), §3.5)."""

from torch import Tensor

from uavrl.models.collision_classifier import confusion_rates


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
        >>> import torch
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
        >>> import torch
        >>> annealed_weight(10.0, torch.tensor([1.0, 0.0, 0.0, 0.0])), annealed_weight(10.0, torch.zeros(0))
        (7.5, 10.0)
    """
    rate = float(successes.double().mean()) if len(successes) else 0.0
    return penalty_weight * (1.0 - min(max(rate, 0.0), 1.0))


def is_trusted(counts: Tensor, evaluations: int, min_evaluations: int, min_true_negative_rate: float) -> bool:
    """The actor listens after more than ``min_evaluations`` evaluations, while the true-negative rate exceeds a limit.

    Args:
        counts: ``[E, 4]``, rows of :func:`~uavrl.models.collision_classifier.confusion_counts`.
        evaluations: how many there ever were.
        min_evaluations: how many are not enough.
        min_true_negative_rate: the rate that is not enough.

    Examples:
        >>> import torch
        >>> counts = torch.tensor([[50, 1, 49, 0]])
        >>> is_trusted(counts, 21, 20, 0.96), is_trusted(counts, 20, 20, 0.96), is_trusted(counts, 21, 20, 0.98)
        (True, False, False)
    """
    return evaluations > min_evaluations and confusion_rates(counts).true_negative > min_true_negative_rate
