"""LifeGuard's arithmetic as pure tensor functions (Chansuparp (2022), §3.5)."""

import torch
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


def risk_labels(collided: Tensor, terminated: Tensor, risk_tp1: Tensor, risk_discount: float) -> Tensor:
    """What c should say of a transition: 1 where it collides, else ``(1 - terminated) γ_r c(o', μ(s'))``.

    Its fixed point is the discounted probability of a collision ahead (Srinivasan et al. (2020), arXiv:2010.14603;
    Thananjeyan et al. (2021), arXiv:2010.15920, Eq. 2). With γ_r = 0 these are the labels of Chansuparp (2022),
    Eq. 3.8.

    Args:
        collided: bool ``[*B]``.
        terminated: bool ``[*B]``, whether no step follows.
        risk_tp1: c(o', μ(s')), ``[*B]``.
        risk_discount: γ_r.

    Examples:
        >>> import torch
        >>> collided, terminated = torch.tensor([True, False, False]), torch.tensor([True, True, False])
        >>> risk_labels(collided, terminated, torch.tensor([0.2, 0.2, 0.5]), 0.5).tolist()
        [1.0, 0.0, 0.25]
    """
    return torch.where(collided, 1.0, torch.where(terminated, 0.0, risk_discount * risk_tp1))


def calibration(collisions: int, steps: int) -> tuple[float, float]:
    """What samples of collisions and of other steps must weigh in batches of as many of each: 2π and 2 (1 - π).

    So weighed, c is the probability that was asked for, and not that of a world in which every other step collides.

    Args:
        collisions: that were seen.
        steps: that were seen, among which they were; their share is π.

    Examples:
        >>> calibration(1, 200)
        (0.01, 1.99)
    """
    share = collisions / steps
    return 2 * share, 2 * (1 - share)


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
