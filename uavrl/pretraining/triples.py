"""Consecutive states of one episode."""

import numpy as np


def triple_centres(episode: np.ndarray) -> np.ndarray:
    """The indices t for which t-1, t and t+1 belong to one episode.

    Args:
        episode: ``[N]``, the episode that each state belongs to; states of an episode lie together, in order.

    Returns:
        ``[M]``, ascending.

    Examples:
        >>> triple_centres(np.array([0, 0, 0, 0, 1, 1, 2, 2, 2]))
        array([1, 2, 7])
    """
    if episode.ndim != 1:
        raise ValueError(f"Expected the episodes [N] of N states, got {list(episode.shape)}.")
    inside = (episode[1:-1] == episode[:-2]) & (episode[1:-1] == episode[2:])
    return np.flatnonzero(inside) + 1
