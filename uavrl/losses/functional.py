"""Equations as pure tensor functions: FORK's (Chansuparp (2022), Eq. 2.14; Wei & Ying (2020)), and XQC's."""

import torch
import torch.nn.functional as F
from torch import Tensor

from uavrl.entries import require_whole

__all__ = [
    "check_episodes",
    "clamped_smooth_l1",
    "episode_returns",
    "fork_objective",
    "fork_weight",
    "least_valued",
    "project_distribution",
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


def episode_returns(reward: Tensor, done: Tensor) -> Tensor:
    """The undiscounted returns ``[E]`` of whole episodes, end to end.

    Args:
        reward: ``[T]``.
        done: ``[T]`` boolean, true where an episode ends.

    Examples:
        >>> episode_returns(torch.tensor([1.0, 2.0, 5.0]), torch.tensor([False, True, True]))
        tensor([3., 5.])
    """
    episode = done.cumsum(0) - done.long()
    return reward.new_zeros(int(done.sum())).index_add(0, episode, reward)


def check_episodes(states: Tensor, rewards: Tensor, done: Tensor, *, width: int) -> None:
    """Refuses what are not whole episodes, end to end, of states ``[T, width]`` and finite numbers.

    Raises:
        ValueError: saying what is wrong.

    Examples:
        >>> check_episodes(torch.zeros(2, 3), torch.zeros(2), torch.tensor([False, True]), width=3)
    """
    if states.ndim != 2:
        raise ValueError(f"observe expected states [T, {width}], got {list(states.shape)}: flatten the episodes.")
    require_whole(done, flat=True)
    if states.shape[-1] != width:
        raise ValueError(f"observe expected states of width {width}, got {states.shape[-1]}: set observations.")
    for name, values in (("states", states), ("rewards", rewards)):
        if bad := int((~torch.isfinite(values)).sum()):
            raise ValueError(f"observe expected finite {name}, got {bad} values that are not: mend the world.")


def project_distribution(probabilities: Tensor, values: Tensor, support: Tensor) -> Tensor:
    """Move a distribution to other values: each probability goes to the two atoms around its value.

    ``m_j = Σ_i p_i max(0, 1 - |clip(v_i, z_1, z_N) - z_j| / Δz)`` (Bellemare et al. 2017, arXiv 1707.06887, Eq. 7).
    The mean stays, unless a value outside the support is clipped.

    Args:
        probabilities: p, ``[*B, M]``.
        values: v, that these are of, ``[*B, M]``.
        support: z, N atoms from the smallest to the largest, evenly spaced, ``[N]``.

    Returns:
        m, ``[*B, N]``.

    Raises:
        ValueError: when the shapes do not fit.

    Examples:
        >>> half, support = torch.tensor([0.5, 0.5]), torch.tensor([0.0, 1.0, 2.0])
        >>> project_distribution(half, torch.tensor([0.25, 7.0]), support)
        tensor([0.3750, 0.1250, 0.5000])
    """
    if probabilities.shape != values.shape or support.ndim != 1 or len(support) < 2:
        raise ValueError(
            f"Expected probabilities and values of one shape, and two atoms or more, got {tuple(probabilities.shape)}, "
            f"{tuple(values.shape)} and {tuple(support.shape)}: reshape them to match."
        )
    values = values.clamp(support[0], support[-1])
    distance = (values.unsqueeze(-1) - support).abs() / (support[1] - support[0])
    return (probabilities.unsqueeze(-1) * (1 - distance).clamp_min(0)).sum(-2)


def least_valued(probabilities: Tensor, support: Tensor) -> Tensor:
    """Return for each sample the distribution with the smallest mean of K: ``[K, *B, N]`` to ``[*B, N]``.

    Examples:
        >>> both = torch.tensor([[[0.1, 0.9]], [[0.6, 0.4]]])
        >>> least_valued(both, torch.tensor([-1.0, 1.0]))
        tensor([[0.6000, 0.4000]])
    """
    smallest = (probabilities @ support).argmin(0)
    return probabilities.take_along_dim(smallest[None, ..., None], 0).squeeze(0)
