"""The equations of a buffer's write path as functions of whole episodes.

The augmentative backward reward is that of Chansuparp (2022), §3.4, Eq. 3.5, Algorithm 3.1.

Algorithm 3.1 counts steps from 1: a_t is taken in s_t, earns r_t and leads to s_{t+1}. Window k holds the steps
Z - p_frames + 1 to Z with Z = k p_frames; the thesis prints k + p_frames, by which all windows would overlap.
"""

import torch
from torch import Tensor

from uavrl.buffers.history import TrajectoryHistory
from uavrl.entries import require_whole


def window_ends(steps: int, frames: int = 3) -> Tensor:
    """The last step of each window: Z = k p_frames for k = 1 … ⌊T / p_frames⌋ (Algorithm 3.1), else ValueError.

    They are int64 ``[T // frames]``, counted from 0, so that 2 is the third step. The rest of the T steps belongs to no
    window.

    Examples:
        >>> window_ends(10).tolist(), window_ends(2).tolist()
        ([2, 5, 8], [])
    """
    if frames < 1:
        raise ValueError(f"Expected windows of at least one step, got frames={frames}: Table 4.1 has 3.")
    return torch.arange(1, steps // frames + 1) * frames - 1


def window_sums(reward: Tensor, frames: int = 3) -> Tensor:
    """The sum of each window's rewards: r_{Z - p_frames + 1} + … + r_Z (Algorithm 3.1, before it is floored).

    The rewards ``[T]`` of one episode give float64 ``[T // frames]``, so that neither the order nor the device moves a
    sum across an integer.

    Raises:
        ValueError: for another shape or type, or sums that are not finite.

    Examples:
        >>> window_sums(torch.tensor([1.0, 2.5, 0.25, -0.5, 0.0, 0.25, 99.0])).tolist()
        [3.75, -0.25]
    """
    if reward.ndim != 1 or not reward.is_floating_point():
        raise ValueError(f"Expected the rewards of one episode, floats [T], got {reward.dtype} {list(reward.shape)}.")
    whole = len(window_ends(len(reward), frames)) * frames
    sums = reward[:whole].double().reshape(-1, frames).sum(-1)
    if not bool((sums.abs() < 2.0**63).all()):
        raise ValueError(
            "Expected finite rewards in a successful episode, got a window whose sum is not: check the reward."
        )
    return sums


def backward_reward(
    reward: Tensor,
    labels: Tensor,
    history: TrajectoryHistory,
    *,
    frames: int = 3,
    multiplier: float = 0.2,
) -> Tensor:
    """Relabels one successful episode: r += m p_addReward in each window (Eq. 3.5, Algorithm 3.1).

    m is the place of the window's floored sum R among the distinct ones that its class has seen, itself included.
    The windows enter the history one after the other, so that earlier ones of the same episode count.

    Args:
        reward: ``[T]``; it is not modified.
        labels: the class l of each window, integers ``[T // frames]``.
        history: H; the windows are added to it.
        frames: p_frames.
        multiplier: p_addReward.

    Returns:
        The new rewards ``[T]``, in the type of ``reward``.

    Raises:
        ValueError: for other shapes or types; the history is untouched then.

    Examples:
        >>> history = TrajectoryHistory()
        >>> reward = torch.tensor([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 5.0])
        >>> new = backward_reward(reward, torch.tensor([0, 0]), history, multiplier=0.5)
        >>> new.tolist(), history.values(0)
        ([1.0, 1.0, 1.0, 2.5, 2.5, 2.5, 5.0], [3, 6])
    """
    sums = window_sums(reward, frames)
    check_labels(labels, len(sums))
    ranks = [history.insert_and_rank(label, r) for label, r in zip(labels.tolist(), sums.tolist(), strict=True)]
    places = torch.tensor(ranks, dtype=torch.float64)
    new = reward.clone()
    new[: len(ranks) * frames] += (places * multiplier).repeat_interleave(frames).to(reward)
    return new


def multi_step_returns(reward: Tensor, done: Tensor, gamma: float, n_steps: int) -> tuple[Tensor, Tensor]:
    """The discounted sum of the next n rewards, and its number of steps.

    ``R_t = Σ_{i<k} γ^i r_{t+i}`` with ``k = min(n, steps to the episode's end)`` (Sutton (1988); Barth-Maron et al.
    (2018), Eq. 3: the target is ``R_t + γ^k Q(s_{t+k}, μ(s_{t+k}))``).

    Args:
        reward: ``[T]``, of whole episodes, end to end.
        done: ``[T]``, true at the last step of each.
        gamma: discount γ.
        n_steps: n.

    Returns:
        ``R [T]`` and ``k [T]``.

    Raises:
        UavrlError: when the last step does not end an episode.

    Examples:
        >>> done = torch.tensor([False, False, True, True])
        >>> returns, steps = multi_step_returns(torch.tensor([1.0, 2.0, 4.0, 8.0]), done, gamma=0.5, n_steps=2)
        >>> returns.tolist(), steps.tolist()
        ([2.0, 4.0, 4.0, 8.0], [2, 2, 1, 1])
    """
    require_whole(done, flat=True)
    at = torch.arange(len(done), device=done.device)
    ends = done.nonzero().flatten()
    steps = (ends[torch.searchsorted(ends, at)] - at + 1).clamp(max=n_steps)
    returns = torch.zeros_like(reward)
    for i in range(n_steps):
        returns += gamma**i * torch.where(i < steps, reward.roll(-i), 0.0)
    return returns, steps


def stacked_frames(states: Tensor, done: Tensor) -> list[int]:
    """Return the numbers of frames, from 2, that states ``[T, S]`` of whole episodes may be stacked of.

    In a stack of F frames, oldest first, each state is the state before it, moved up by one frame of S / F numbers.

    Args:
        states: ``[T, S]``.
        done: ``[T]``, true at the last step of each episode.

    Returns:
        The numbers F for which this holds, in ascending order: several where hardly anything changes.

    Examples:
        >>> states = torch.tensor([[0.0, 0.0, 1.0, 2.0], [1.0, 2.0, 3.0, 4.0]])
        >>> stacked_frames(states, torch.tensor([False, True]))
        [2]
    """
    follows = ~done[:-1]
    before, after, width = states[:-1][follows], states[1:][follows], states.shape[-1]
    numbers = [frames for frames in range(2, width + 1) if width % frames == 0]
    return [f for f in numbers if torch.equal(before[:, width // f :], after[:, : width - width // f])]


def check_labels(labels: Tensor, count: int) -> None:
    """Raises ValueError for labels that are not ``count`` integers."""
    integer = isinstance(labels, Tensor) and not (labels.is_floating_point() or labels.is_complex())
    if not integer or labels.dtype == torch.bool or labels.shape != (count,):
        got = f"{labels.dtype} {list(labels.shape)}" if isinstance(labels, Tensor) else type(labels).__name__
        raise ValueError(f"Expected one integer label for each window, [{count}], got {got}: check the classifier.")
