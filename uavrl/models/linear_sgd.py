"""A linear classifier and its stochastic gradient descent as pure functions (Chansuparp (2022), Eq. 3.7-3.10)."""

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import softplus

_SMALLEST_SCALE = 1e-9


def decision_function(x: Tensor, weight: Tensor, intercept: Tensor) -> Tensor:
    """Chansuparp (2022), Eq. 3.7: ``c(x) = w·x + j``, the logit ``[*B]`` of the class 1.

    Args:
        x: features ``[*B, F]``.
        weight: w, ``[F]``, else ValueError.
        intercept: j, a scalar.

    Examples:
        >>> decision_function(torch.tensor([[1.0, 2.0]]), torch.tensor([3.0, -1.0]), torch.tensor(0.5)).tolist()
        [1.5]
    """
    if weight.ndim != 1 or x.shape[-1:] != weight.shape:
        raise ValueError(f"Expected features [*B, F] for weights [F], got {tuple(x.shape)} and {tuple(weight.shape)}.")
    return (x * weight).sum(-1) + intercept


def logistic_loss(logit: Tensor, y: Tensor) -> Tensor:
    """Chansuparp (2022), Eq. 3.9: ``log(1 + exp(-y c))`` with y in {-1, 1}, here from labels in {0, 1}; ``[*B]``.

    The text names labels in {0, 1} and prints the loss for {-1, 1}: with 0 it would be a constant.

    Args:
        logit: c(x), ``[*B]``.
        y: labels in {0, 1}, bool or float ``[*B]``, else ValueError.

    Examples:
        >>> logistic_loss(torch.tensor([0.0, 2.0]), torch.tensor([0.0, 1.0]))
        tensor([0.6931, 0.1269])
    """
    if logit.shape != y.shape:
        raise ValueError(f"Expected one label for each logit, got {tuple(y.shape)} and {tuple(logit.shape)}.")
    return softplus((1.0 - 2.0 * y.to(logit.dtype)) * logit)


def regularized_error(loss: Tensor, weights: list[Tensor], alpha: float) -> Tensor:
    """Chansuparp (2022), Eq. 3.8 for each sample: ``L_i + α R(w)`` with ``R = ½ ‖w‖²``; its mean is E.

    Args:
        loss: the losses of Eq. 3.9, ``[*B]``.
        weights: the regularised tensors: w, or the matrices of a network; the intercept is not among them.
        alpha: α.

    Examples:
        >>> regularized_error(torch.tensor([1.0, 2.0]), [torch.tensor([3.0, 4.0])], 0.1).tolist()
        [2.25, 3.25]
    """
    norm = sum((w.square().sum() for w in weights), start=loss.new_zeros(()))
    return loss + 0.5 * alpha * norm.to(loss.dtype)


def initial_time(alpha: float) -> float:
    """``t_0`` of Eq. 3.10 by Bottou's heuristic, as scikit-learn's ``learning_rate="optimal"`` has it.

    It makes the first step the size ``α^(-1/4)`` that a weight is expected to have. ValueError unless α is positive.

    Examples:
        >>> round(initial_time(1e-4), 6)
        1000.0
    """
    if not alpha > 0.0:
        raise ValueError(f"alpha must be positive, got {alpha}.")
    return 1.0 / (math.sqrt(1.0 / math.sqrt(alpha)) * alpha)


def learning_rate(t: float, alpha: float) -> float:
    """Chansuparp (2022), Eq. 3.10: ``lr = 1 / (α (t_0 + t))``.

    The sum is scikit-learn's, ``(t_0 + t') - 1`` with ``t' = t + 1``: early steps amplify its rounding a thousandfold.

    Args:
        t: number of samples seen before.
        alpha: α.

    Examples:
        >>> round(learning_rate(0, 1e-4), 6), round(learning_rate(1000, 1e-4), 6)
        (10.0, 5.0)
    """
    return 1.0 / (alpha * (initial_time(alpha) + (t + 1) - 1))


def sgd_epoch(
    weight: Tensor, intercept: Tensor, x: Tensor, y: Tensor, t: int, alpha: float
) -> tuple[Tensor, Tensor, int]:
    """Chansuparp (2022), Eq. 3.10: one step for each sample, in the order given, in double precision.

    It does what ``partial_fit`` of scikit-learn's ``SGDClassifier(loss="log_loss", learning_rate="optimal",
    shuffle=False)`` does: the error at the old weights, then the decay of the weights, then the gradient.

    Args:
        weight: w, ``[F]``; it is not modified.
        intercept: j, a scalar; it is not regularised.
        x: features ``[N, F]``, finite, else ValueError.
        y: labels in {0, 1}, ``[N]``.
        t: number of samples seen before.
        alpha: α.

    Returns:
        The new w ``[F]`` and j (float64, on the CPU), and t + N.

    Examples:
        >>> w, j, t = sgd_epoch(torch.zeros(2), torch.zeros(()), torch.tensor([[1.0, 0.5]]), torch.ones(1), 0, 1e-4)
        >>> w, j, t  # at zero weights: the error is ½ - 1, the step 10
        (tensor([5.0000, 2.5000], dtype=torch.float64), tensor(5., dtype=torch.float64), 1)
    """
    if x.ndim != 2 or x.shape[1:] != weight.shape or y.shape != x.shape[:1]:
        raise ValueError(
            f"Expected features [N, F], labels [N] and weights [F], got {tuple(x.shape)}, {tuple(y.shape)} and "
            f"{tuple(weight.shape)}."
        )
    w = weight.detach().double().cpu().numpy().copy()
    j = float(intercept)
    rows = x.detach().double().cpu().numpy()
    if not np.isfinite(rows).all():
        raise ValueError("Expected finite features, got a NaN or an infinity: clean the data first.")
    scale = 1.0  # the weights are scale * w: their decay costs one product
    for row, label in zip(rows, y.tolist(), strict=True):
        step = learning_rate(t, alpha)
        # Summed in order: early steps amplify a rounding error thirtyfold a sample, so another order is another model.
        logit = scale * float(np.add.accumulate(w * row)[-1]) + j
        update = -step * _slope(logit, label)
        scale *= max(0.0, 1.0 - step * alpha)
        if scale < _SMALLEST_SCALE:
            w *= scale
            scale = 1.0
        w += row * (update / scale)
        j += update
        t += 1
    return torch.from_numpy(w * scale), torch.tensor(j, dtype=torch.float64), t


def _slope(logit: float, label: float) -> float:
    """The derivative of Eq. 3.9 in c, ``σ(c) - y``, without cancellation or overflow."""
    if logit <= -37.0:  # σ(c) is e^c in double precision
        return math.exp(logit) - label
    odds = math.exp(-logit)
    return ((1.0 - label) - label * odds) / (1.0 + odds)
