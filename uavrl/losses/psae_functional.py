"""The all-positive Siamese autoencoder's loss as pure tensor functions (Chansuparp (2022), Eq. 3.3)."""

import torch.nn.functional as F
from torch import Tensor

__all__ = ["neighbour_similarity", "psae_loss", "reconstruction_error"]


def _check_triples(**tensors: Tensor) -> None:
    for name, tensor in tensors.items():
        if tensor.ndim < 2 or tensor.shape[0] != 3:
            raise ValueError(
                f"Expected {name} [3, *B, D] of the states at t-1, t and t+1, got {tuple(tensor.shape)}: "
                f"stack the three along a new first dimension."
            )


def reconstruction_error(states: Tensor, reconstructions: Tensor) -> Tensor:
    """The first sum of Eq. 3.3, ``Σ_i ‖s_i - s̃_i‖²`` over the three networks.

    Args:
        states: ``[3, *B, D]``, the states at t-1, t and t+1.
        reconstructions: ``[3, *B, D]``.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: for other shapes.

    Examples:
        >>> import torch
        >>> states = torch.tensor([[1.0, 0.0], [2.0, 2.0], [0.0, 3.0]])
        >>> reconstruction_error(states, torch.zeros(3, 2))  # 1 + 8 + 9
        tensor(18.)
    """
    _check_triples(states=states)
    if states.shape != reconstructions.shape:
        raise ValueError(
            f"Expected reconstructions of the states' shape {tuple(states.shape)}, got {tuple(reconstructions.shape)}."
        )
    return (states - reconstructions).square().sum(-1).sum(0)


def neighbour_similarity(features: Tensor) -> Tensor:
    """The second sum of Eq. 3.3, ``cos(ŝ_t, ŝ_{t-1}) + cos(ŝ_t, ŝ_{t+1})``.

    Args:
        features: ``[3, *B, F]``, of the states at t-1, t and t+1.

    Returns:
        ``[*B]``, in [-2, 2].

    Raises:
        ValueError: for other shapes.

    Examples:
        >>> import torch
        >>> neighbour_similarity(torch.tensor([[0.0, 2.0], [3.0, 4.0], [4.0, -3.0]]))  # 0.8 + 0
        tensor(0.8000)
    """
    _check_triples(features=features)
    before, anchor, after = features
    return F.cosine_similarity(anchor, before, -1) + F.cosine_similarity(anchor, after, -1)


def psae_loss(error: Tensor, similarity: Tensor, tradeoff: float = 0.7) -> Tensor:
    """Eq. 3.3: ``p Σ_i ‖s_i - s̃_i‖² - (1 - p) Σ_j cos(ŝ_t, ŝ_{t+j})``, j = -1, 1.

    Args:
        error: ``[*B]``, of :func:`reconstruction_error`.
        similarity: ``[*B]``, of :func:`neighbour_similarity`.
        tradeoff: p_wae.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: when the two differ in shape.

    Examples:
        >>> import torch
        >>> psae_loss(torch.tensor(18.0), torch.tensor(0.8))  # 0.7 * 18 - 0.3 * 0.8
        tensor(12.3600)
    """
    if error.shape != similarity.shape:
        raise ValueError(
            f"Expected error and similarity of one shape, got {tuple(error.shape)} and {tuple(similarity.shape)}."
        )
    return tradeoff * error - (1 - tradeoff) * similarity
