"""FORK's equations as pure tensor functions (Chansuparp (2022), Eq. 2.14; Wei & Ying (2020))."""

import torch
import torch.nn.functional as F
from torch import Tensor

__all__ = [
    "bipedal_fork_objective",
    "clamped_smooth_l1",
    "fork_objective",
    "fork_weight",
    "masked_mse",
]


def _same_shape(**tensors: Tensor) -> None:
    if len({tensor.shape for tensor in tensors.values()}) > 1:
        shapes = ", ".join(f"{name} {tuple(tensor.shape)}" for name, tensor in tensors.items())
        raise ValueError(f"Expected tensors of one shape, got {shapes}: reshape them to match.")


def fork_objective(g_t: Tensor, g_tp1: Tensor, q_tp2: Tensor, weight: float | Tensor, gamma: float) -> Tensor:
    """What FORK adds to the actor's objective (Eq. 2.14, weighted): ``-w [g_t + γ g_tp1 + γ² Q_tp2]``.

    Args:
        g_t: ``[*B]``, predicted reward of the action at the state.
        g_tp1: ``[*B]``, predicted reward of the action at the first predicted state.
        q_tp2: ``[*B]``, value of the action at the second predicted state.
        weight: w.
        gamma: discount γ.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: when the shapes differ.

    Examples:
        >>> fork_objective(torch.tensor([1.0]), torch.tensor([2.0]), torch.tensor([4.0]), 0.6, 0.5)
        tensor([-1.8000])
    """
    _same_shape(g_t=g_t, g_tp1=g_tp1, q_tp2=q_tp2)
    return -weight * (g_t + gamma * g_tp1 + gamma**2 * q_tp2)


def bipedal_fork_objective(q_tp1: Tensor, q_tp2: Tensor, weight: float | Tensor) -> Tensor:
    """What FORK's variant for the bipedal walker adds: ``-w Q'_tp1 - 0.5 w Q'_tp2``, without predicted rewards.

    Args:
        q_tp1: ``[*B]``, target value of the action at the first predicted state.
        q_tp2: ``[*B]``, target value of the action at the second predicted state.
        weight: w.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: when the shapes differ.

    Examples:
        >>> bipedal_fork_objective(torch.tensor([2.0]), torch.tensor([4.0]), 0.5)
        tensor([-2.])
    """
    _same_shape(q_tp1=q_tp1, q_tp2=q_tp2)
    return -weight * (q_tp1 + 0.5 * q_tp2)


def fork_weight(returns: Tensor, max_reward: float, base_weight: float = 0.6) -> Tensor:
    """FORK's weight: ``w = w_0 (1 - clip(mean(returns) / max_reward, 0, 1))``.

    The better the policy, the less is added to its objective.

    Args:
        returns: ``[E]``, undiscounted returns of the last episodes; none count as 0.
        max_reward: return at which the weight is 0.
        base_weight: ``w_0``.

    Returns:
        A scalar tensor.

    Raises:
        ValueError: for a max_reward that is not positive, or returns of another shape.

    Examples:
        >>> fork_weight(torch.tensor([10.0, 30.0]), max_reward=80.0)
        tensor(0.4500)
    """
    if returns.ndim != 1:
        raise ValueError(f"fork_weight expected returns [E], got shape {tuple(returns.shape)}: flatten them.")
    if max_reward <= 0:
        raise ValueError(f"fork_weight expected a positive max_reward, got {max_reward}: give the best return.")
    mean = returns.mean() if returns.numel() else returns.new_zeros(())
    return base_weight * (1 - (mean / max_reward).clamp(0, 1))


def clamped_smooth_l1(prediction: Tensor, target: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Smooth-L1 of a prediction that is first clamped to the observed range, averaged over the dimensions.

    Args:
        prediction: ``[*B, D]``.
        target: ``[*B, D]``.
        low: smallest value observed, broadcast to ``[*B, D]``.
        high: largest value observed, broadcast to ``[*B, D]``.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: when prediction and target differ in shape.

    Examples:
        >>> prediction, target = torch.tensor([[5.0, 0.5]]), torch.tensor([[0.0, 0.0]])
        >>> clamped_smooth_l1(prediction, target, torch.tensor(-1.0), torch.tensor(2.0))  # (1.5 + 0.125) / 2
        tensor([0.8125])
    """
    _same_shape(prediction=prediction, target=target)
    return F.smooth_l1_loss(prediction.clamp(low, high), target, reduction="none").mean(-1)


def masked_mse(prediction: Tensor, target: Tensor, done: Tensor) -> Tensor:
    """Squared error times ``1 - done``, averaged over the dimensions.

    Args:
        prediction: ``[*B, D]``.
        target: ``[*B, D]``.
        done: ``[*B]`` boolean; such samples count as 0.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: when the shapes do not match.

    Examples:
        >>> prediction, target = torch.tensor([[1.0, 3.0], [7.0, 7.0]]), torch.zeros(2, 2)
        >>> masked_mse(prediction, target, torch.tensor([False, True]))
        tensor([5., 0.])
    """
    _same_shape(prediction=prediction, target=target)
    _same_shape(done=done, each_of_prediction=prediction[..., 0])
    return torch.where(done, 0.0, (prediction - target).square().mean(-1))
