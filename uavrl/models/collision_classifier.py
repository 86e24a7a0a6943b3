"""What LifeGuard asks: does this action collide (Chansuparp (2022), §3.5)?"""

from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from uavrl.models.classifiers import LinearClassifier, MinMaxScaler, MLPClassifier
from uavrl.models.linear_sgd import logistic_loss, regularized_error


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
        return regularized_error(logistic_loss(self(features), collided), weights, self.alpha)

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
        """Counts ``[4]`` of what it says of features ``[N, F]`` with labels ``[N]``; see :func:`confusion_counts`."""
        return confusion_counts(self(features) > 0, collided)


def confusion_counts(predicted: Tensor, actual: Tensor) -> Tensor:
    """Counts true positives, false positives, true negatives and false negatives; a collision is positive.

    Args:
        predicted: bool ``[N]``.
        actual: bool ``[N]``.

    Returns:
        int64 ``[4]``.

    Raises:
        ValueError: for other shapes or types.

    Examples:
        >>> t = torch.tensor
        >>> confusion_counts(t([True, True, False, False, False]), t([True, False, False, False, True])).tolist()
        [1, 1, 2, 1]
    """
    if predicted.shape != actual.shape or predicted.ndim != 1 or {predicted.dtype, actual.dtype} != {torch.bool}:
        raise ValueError(
            f"Expected two bool vectors of one length, got {tuple(predicted.shape)} {predicted.dtype} and "
            f"{tuple(actual.shape)} {actual.dtype}."
        )
    cells = (predicted & actual, predicted & ~actual, ~predicted & ~actual, ~predicted & actual)
    return torch.stack([cell.sum() for cell in cells])


class ConfusionRates(NamedTuple):
    """Shares of the actual positives or negatives; 0 where there are none."""

    true_positive: float
    false_positive: float
    true_negative: float
    false_negative: float


def confusion_rates(counts: Tensor) -> ConfusionRates:
    """Rates over several evaluations.

    Args:
        counts: ``[E, 4]``, rows of :func:`confusion_counts`.

    Examples:
        >>> [round(rate, 2) for rate in confusion_rates(torch.tensor([[1, 1, 2, 1], [3, 0, 1, 1]]))]
        [0.67, 0.25, 0.75, 0.33]
    """
    tp, fp, tn, fn = counts.sum(0).tolist()
    positives, negatives = max(tp + fn, 1), max(tn + fp, 1)
    return ConfusionRates(tp / positives, fp / negatives, tn / negatives, fn / positives)
