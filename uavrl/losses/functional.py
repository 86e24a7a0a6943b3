"""The losses' equations as pure tensor functions (Chansuparp (2022), Eq. 2.7–2.14; Wei & Ying (2020))."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

__all__ = [
    "bipedal_fork_objective",
    "clamped_smooth_l1",
    "deterministic_policy_objective",
    "fork_objective",
    "fork_weight",
    "masked_mse",
    "squared_error",
    "target_action",
    "td_target",
]


def _same_shape(**tensors: Tensor) -> None:
    if len({tensor.shape for tensor in tensors.values()}) > 1:
        shapes = ", ".join(f"{name} {tuple(tensor.shape)}" for name, tensor in tensors.items())
        raise ValueError(f"Expected tensors of one shape, got {shapes}: reshape them to match.")


# ---------------------------------------------------------------------- DDPG and TD3


def target_action(action_t: Tensor, noise_t: Tensor, clip: float | Tensor, low: Tensor, high: Tensor) -> Tensor:
    """The smoothed target action (Eq. 2.10): ``clip(μ'(s_t) + clip(ε, -c, c), a_low, a_high)``.

    Args:
        action_t: ``[*B, A]``, the target actor's action at the next state.
        noise_t: ``[*B, A]``, ε, drawn from N(0, σ).
        clip: c, a number or ``[A]``.
        low: smallest action, broadcast to ``[*B, A]``.
        high: largest action, broadcast to ``[*B, A]``.

    Returns:
        ``[*B, A]``.

    Raises:
        ValueError: when action and noise differ in shape.

    Examples:
        >>> bound = torch.tensor(2.0)
        >>> target_action(torch.tensor([1.9, 0.0]), torch.tensor([0.3, -9.0]), 0.5, -bound, bound)
        tensor([ 2.0000, -0.5000])
    """
    _same_shape(action_t=action_t, noise_t=noise_t)
    limit = torch.as_tensor(clip, dtype=noise_t.dtype, device=noise_t.device)
    return (action_t + noise_t.clamp(-limit, limit)).clamp(low, high)


def td_target(r_t: Tensor, terminated_t: Tensor, q_t: Tensor, gamma: float) -> Tensor:
    """The target of the critics (Eq. 2.11; with one critic Eq. 2.7): ``r + γ (1 - d) min_j Q'_j(s_t, a'_t)``.

    Args:
        r_t: ``[*B]``, reward of the transition.
        terminated_t: ``[*B]`` boolean, d: the episode ended there, other than by a time-out.
        q_t: ``[K, *B]``, the K target critics' values at the next state.
        gamma: discount γ.

    Returns:
        ``[*B]``, without gradient.

    Raises:
        ValueError: when the shapes do not match.

    Examples:
        >>> q_t = torch.tensor([[1.0, 5.0], [3.0, 4.0]])
        >>> td_target(torch.tensor([1.0, 2.0]), torch.tensor([False, True]), q_t, 0.5)
        tensor([1.5000, 2.0000])
    """
    _same_shape(r_t=r_t, terminated_t=terminated_t, each_of_q_t=q_t[0])
    return (r_t + gamma * torch.where(terminated_t, 0.0, q_t.amin(0))).detach()


def squared_error(q_tm1: Tensor, target: Tensor) -> Tensor:
    """The critics' loss for each sample (Eq. 2.8, 2.12): ``Σ_j (y - Q_j(s_tm1, a_tm1))²``.

    Args:
        q_tm1: ``[K, *B]``, the K critics' values.
        target: ``[*B]``, y.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: when the shapes do not match.

    Examples:
        >>> squared_error(torch.tensor([[1.0], [4.0]]), torch.tensor([2.0]))
        tensor([5.])
    """
    _same_shape(each_of_q_tm1=q_tm1[0], target=target)
    return (target - q_tm1).square().sum(0)


def deterministic_policy_objective(q: Tensor) -> Tensor:
    """What the actor minimises for each sample (Eq. 2.13): ``-Q(s, μ(s))``.

    Args:
        q: ``[*B]``, the critic's value of the actor's action.

    Returns:
        ``[*B]``.
    """
    return -q


# ---------------------------------------------------------------------- FORK


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
        ValueError: for a return that is not positive, or returns of another shape.

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
