"""LifeGuard's question, whether an action collides, and the classifiers that answer it (Chansuparp (2022), §3.5)."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from uavrl.models.actor_critic import mlp

_SMALLEST_SCALE = 1e-9


def regularized_error(logit: Tensor, y: Tensor, weights: list[Tensor], alpha: float) -> Tensor:
    """Chansuparp (2022), Eq. 3.8-3.9 for each sample: ``log(1 + exp(-y c)) + α ½ ‖w‖²``; its mean is E.

    The text names labels in {0, 1} and prints the loss for {-1, 1}, with 0 it would be a constant: y is 2 label - 1.

    Args:
        logit: c(x), ``[*B]``.
        y: labels in {0, 1}, bool or float ``[*B]``, else ValueError.
        weights: the regularised tensors: w, or the matrices of a network; the intercept is not among them.
        alpha: α.

    Examples:
        >>> regularized_error(torch.tensor([0.0, 2.0]), torch.tensor([0.0, 1.0]), [torch.tensor([3.0, 4.0])], 0.1)
        tensor([1.9431, 1.3769])
    """
    if logit.shape != y.shape:
        raise ValueError(f"Expected one label for each logit, got {tuple(y.shape)} and {tuple(logit.shape)}.")
    loss = softplus((1.0 - 2.0 * y.to(logit.dtype)) * logit)
    norm = sum((w.square().sum() for w in weights), start=loss.new_zeros(()))
    return loss + 0.5 * alpha * norm.to(loss.dtype)


def learning_rate(t: float, alpha: float) -> float:
    """Chansuparp (2022), Eq. 3.10: ``lr = 1 / (α (t_0 + t))`` after t samples, with Bottou's heuristic for t_0.

    The first step has the size ``α^(-1/4)`` that a weight is expected to have, as in scikit-learn's
    ``learning_rate="optimal"``. The sum is scikit-learn's, ``(t_0 + t') - 1`` with ``t' = t + 1``: early steps amplify
    its rounding a thousandfold. ValueError unless α is positive.

    Examples:
        >>> round(learning_rate(0, 1e-4), 6), round(learning_rate(1000, 1e-4), 6)
        (10.0, 5.0)
    """
    if not alpha > 0.0:
        raise ValueError(f"alpha must be positive, got {alpha}.")
    t_0 = 1.0 / (math.sqrt(1.0 / math.sqrt(alpha)) * alpha)
    return 1.0 / (alpha * (t_0 + (t + 1) - 1))


class LinearClassifier(nn.Module):
    """A logistic classifier, ``c(x) = w·x + j``, trained sample by sample (Chansuparp (2022), Eq. 3.7-3.10).

    Its weights are buffers, since the rule of Eq. 3.10 moves them and no optimiser does.

    Args:
        features: number of features F.
        alpha: α, the strength of the L2 regularisation, which also sets the learning rate.

    Examples:
        >>> classifier = LinearClassifier(2)
        >>> x, y = torch.tensor([[0.0, 1.0], [1.0, 0.0]]), torch.tensor([0.0, 1.0])
        >>> classifier.partial_fit(x.repeat(50, 1), y.repeat(50))
        >>> (classifier(torch.tensor([[0.1, 0.9], [0.8, 0.3]])) > 0).tolist()
        [False, True]
    """

    weight: Tensor
    intercept: Tensor
    t: Tensor

    def __init__(self, features: int, alpha: float = 1e-4) -> None:
        super().__init__()
        self.alpha = alpha
        self.register_buffer("weight", torch.zeros(features, dtype=torch.float64))
        self.register_buffer("intercept", torch.zeros((), dtype=torch.float64))
        self.register_buffer("t", torch.zeros((), dtype=torch.int64))

    def reset_parameters(self) -> None:
        """Zeroes the weights."""
        for buffer in (self.weight, self.intercept, self.t):
            buffer.zero_()

    def forward(self, x: Tensor) -> Tensor:
        """Features ``[*B, F]`` to logits ``[*B]`` of the same type, differentiable in the features."""
        if x.shape[-1:] != self.weight.shape:
            raise ValueError(f"Expected features [*B, {len(self.weight)}], got {tuple(x.shape)}.")
        return (x * self.weight.to(x.dtype)).sum(-1) + self.intercept.to(x.dtype)

    def partial_fit(self, x: Tensor, y: Tensor) -> None:
        """Takes one step of Eq. 3.10 for each sample, in the order given, in double precision.

        It does what ``partial_fit`` of scikit-learn's ``SGDClassifier(loss="log_loss", learning_rate="optimal",
        shuffle=False)`` does: the error at the old weights, then the decay of the weights, then the gradient. The
        intercept does not decay.

        Args:
            x: features ``[N, F]``.
            y: labels in {0, 1}, ``[N]``.

        Raises:
            ValueError: for other shapes, or features that are not finite.
        """
        if x.ndim != 2 or x.shape[1:] != self.weight.shape or y.shape != x.shape[:1]:
            raise ValueError(
                f"Expected features [N, {len(self.weight)}] and labels [N], got {tuple(x.shape)} and {tuple(y.shape)}."
            )
        rows = x.detach().double().cpu().numpy()
        if not np.isfinite(rows).all():
            raise ValueError("Expected finite features, got a NaN or an infinity: clean the data first.")
        w, j = self.weight.double().cpu().numpy().copy(), float(self.intercept)
        scale = 1.0  # the weights are scale * w: their decay costs one product
        for t, (row, label) in enumerate(zip(rows, y.tolist(), strict=True), int(self.t)):
            step = learning_rate(t, self.alpha)
            # Summed in order: early steps amplify a rounding error thirtyfold a sample; another order is another model.
            logit = scale * float(np.add.accumulate(w * row)[-1]) + j
            update = -step * _slope(logit, label)
            scale *= max(0.0, 1.0 - step * self.alpha)
            if scale < _SMALLEST_SCALE:
                w *= scale
                scale = 1.0
            w += row * (update / scale)
            j += update
        self.weight.copy_(torch.from_numpy(w * scale))
        self.intercept.fill_(j)
        self.t += len(x)


def _slope(logit: float, label: float) -> float:
    """The derivative of Eq. 3.9 in c, ``σ(c) - y``, without cancellation or overflow."""
    if logit <= -37.0:  # σ(c) is e^c in double precision
        return math.exp(logit) - label
    odds = math.exp(-logit)
    return ((1.0 - label) - label * odds) / (1.0 + odds)


class MLPClassifier(nn.Module):
    """A logistic classifier of F features with hidden layers of the widths ``hidden``, for a torch optimiser.

    Unlike a linear one it can tell where an action is safe and where the same action collides.

    Examples:
        >>> MLPClassifier(39)(torch.zeros(7, 39)).shape
        torch.Size([7])
    """

    def __init__(self, features: int, hidden: Sequence[int] = (64, 64)) -> None:
        super().__init__()
        self.net = mlp(features, hidden, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Features ``[*B, F]`` to logits ``[*B]``."""
        return self.net(x).squeeze(-1)


class MinMaxScaler(nn.Module):
    """Scales F features to (0, 1) by the smallest and the largest value seen of each.

    Values beyond these bounds are not clamped, so that the gradient does not vanish there. A feature that never
    changed is 0.

    Examples:
        >>> scaler = MinMaxScaler(2)
        >>> scaler.update(torch.tensor([[0.0, 5.0], [4.0, 5.0]]))
        >>> scaler(torch.tensor([[1.0, 5.0]])).tolist()
        [[0.25, 0.0]]
    """

    low: Tensor
    high: Tensor

    def __init__(self, features: int) -> None:
        super().__init__()
        self.register_buffer("low", torch.full((features,), torch.inf))
        self.register_buffer("high", torch.full((features,), -torch.inf))

    def update(self, x: Tensor) -> None:
        """Widens the bounds to features ``[N, F]``."""
        low, high = x.detach().aminmax(dim=0)
        self.low.copy_(torch.minimum(self.low, low))
        self.high.copy_(torch.maximum(self.high, high))

    def forward(self, x: Tensor) -> Tensor:
        """``[*B, F]`` to ``[*B, F]``, else ValueError; all zero before the first update."""
        if x.shape[-1:] != self.low.shape:
            raise ValueError(f"Expected features [*B, {len(self.low)}], got {tuple(x.shape)}.")
        varies = self.high > self.low
        span = torch.where(varies, self.high - self.low, 1.0)
        start = torch.where(varies, self.low, 0.0)
        return torch.where(varies, (x - start) / span, 0.0).to(x.dtype)


class CollisionClassifier(nn.Module):
    """A logistic classifier of features that are scaled to (0, 1) by the range seen so far.

    Args:
        features: number of features F.
        model: ``"linear"`` (the thesis), ``"mlp"``, or a module that takes scaled features ``[*B, F]`` to logits
            ``[*B]``.
        alpha: α of Eq. 3.8, which also sets the linear model's learning rate.

    Raises:
        ValueError: for an unknown model.

    Examples:
        >>> classifier = CollisionClassifier(2)
        >>> features, collided = torch.tensor([[[0.0, 9.0], [4.0, 1.0]]]), torch.tensor([[False, True]])
        >>> classifier.scaler.update(features[0])
        >>> classifier.fit(features.expand(50, -1, -1), collided.expand(50, -1))
        >>> classifier.evaluate(features[0], collided[0]).tolist()  # one true positive, one true negative
        [1, 0, 1, 0]
    """

    def __init__(
        self, features: int, model: Literal["linear", "mlp"] | nn.Module = "linear", alpha: float = 1e-4
    ) -> None:
        super().__init__()
        self.scaler = MinMaxScaler(features)
        self.alpha = alpha
        if isinstance(model, nn.Module):
            self.model = model
        elif model in ("linear", "mlp"):
            self.model = LinearClassifier(features, alpha) if model == "linear" else MLPClassifier(features)
        else:
            raise ValueError(f'model must be "linear", "mlp" or a module, got {model!r}.')

    def forward(self, features: Tensor) -> Tensor:
        """Features ``[*B, F]`` to logits ``[*B]``, differentiable in the features."""
        return self.model(self.scaler(features))

    def error(self, features: Tensor, collided: Tensor) -> Tensor:
        """The summands of Eq. 3.8 for features ``[*B, F]`` and labels ``[*B]``: their mean is the training error."""
        weights: list[Tensor] = [p for p in self.model.parameters() if p.ndim > 1]
        if isinstance(self.model, LinearClassifier):
            weights = [self.model.weight]
        return regularized_error(self(features), collided, weights, self.alpha)

    def fit(self, features: Tensor, collided: Tensor, optimizer: torch.optim.Optimizer | None = None) -> None:
        """One step for each batch; the linear model makes one for each sample, by Eq. 3.10.

        Args:
            features: ``[S, B, F]``, S batches.
            collided: labels, bool ``[S, B]``.
            optimizer: of the parameters, for a model that has any.

        Raises:
            ValueError: when a model with parameters gets no optimiser.
        """
        if isinstance(self.model, LinearClassifier):
            self.model.partial_fit(self.scaler(features).flatten(0, 1), collided.flatten())
            return
        if optimizer is None:
            raise ValueError("Expected an optimiser for the classifier's parameters, got None.")
        for x, y in zip(features, collided, strict=True):
            optimizer.zero_grad(set_to_none=True)
            self.error(x, y).mean().backward()
            optimizer.step()

    @torch.no_grad()
    def evaluate(self, features: Tensor, collided: Tensor) -> Tensor:
        """Counts ``[4]`` of true and false positives, true and false negatives; a collision is positive.

        It takes features ``[N, F]`` and their labels, bool ``[N]``, else ValueError.
        """
        predicted = self(features) > 0
        if predicted.ndim != 1 or collided.shape != predicted.shape or collided.dtype != torch.bool:
            raise ValueError(
                f"Expected features [N, F] and one bool for each, got {tuple(features.shape)} and "
                f"{tuple(collided.shape)} {collided.dtype}."
            )
        cells = (predicted & collided, predicted & ~collided, ~predicted & ~collided, ~predicted & collided)
        return torch.stack([cell.sum() for cell in cells])


class ConfusionRates(NamedTuple):
    """Shares of the actual positives or negatives; 0 where there are none."""

    true_positive: float
    false_positive: float
    true_negative: float
    false_negative: float


def confusion_rates(counts: Tensor) -> ConfusionRates:
    """Rates over several evaluations from their counts ``[E, 4]``, each of :meth:`CollisionClassifier.evaluate`.

    Examples:
        >>> [round(rate, 2) for rate in confusion_rates(torch.tensor([[1, 1, 2, 1], [3, 0, 1, 1]]))]
        [0.67, 0.25, 0.75, 0.33]
    """
    tp, fp, tn, fn = counts.sum(0).tolist()
    positives, negatives = max(tp + fn, 1), max(tn + fp, 1)
    return ConfusionRates(tp / positives, fp / negatives, tn / negatives, fn / positives)
