"""Classifiers of "this action collides" (Chansuparp (2022), §3.5), and the scaling of their features."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from uavrl.models.actor_critic import mlp
from uavrl.models.linear_sgd import decision_function, sgd_epoch


class LinearClassifier(nn.Module):
    """A logistic classifier trained sample by sample (Chansuparp (2022), Eq. 3.7-3.10).

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
        """Forgets what was learnt."""
        for buffer in (self.weight, self.intercept, self.t):
            buffer.zero_()

    def forward(self, x: Tensor) -> Tensor:
        """Features ``[*B, F]`` to logits ``[*B]`` of the same type, differentiable in the features."""
        return decision_function(x, self.weight.to(x.dtype), self.intercept.to(x.dtype))

    def partial_fit(self, x: Tensor, y: Tensor) -> None:
        """Takes one step of Eq. 3.10 for each sample, in the order given.

        Args:
            x: features ``[N, F]``.
            y: labels in {0, 1}, ``[N]``.

        Raises:
            ValueError: for other shapes, or features that are not finite.
        """
        weight, intercept, t = sgd_epoch(self.weight, self.intercept, x, y, int(self.t), self.alpha)
        self.weight.copy_(weight)
        self.intercept.copy_(intercept)
        self.t.fill_(t)


class MLPClassifier(nn.Module):
    """A logistic classifier with hidden layers, trained by a torch optimiser.

    Unlike a linear one it can say of the same action that it is safe here and collides there.

    Args:
        features: number of features F.
        hidden: widths of the hidden layers.

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


def min_max_scale(x: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Scales features ``[*B, F]`` to (0, 1): ``(x - low) / (high - low)``, 0 where high does not exceed low.

    Values outside [low, high] are not clamped, so that the gradient in x does not vanish there.
    """
    if low.ndim != 1 or high.shape != low.shape or x.shape[-1:] != low.shape:
        raise ValueError(
            f"Expected features [*B, F] and bounds [F], got {tuple(x.shape)}, {tuple(low.shape)} and "
            f"{tuple(high.shape)}."
        )
    varies = high > low
    span = torch.where(varies, high - low, 1.0)
    start = torch.where(varies, low, 0.0)
    return torch.where(varies, (x - start) / span, 0.0).to(x.dtype)


class MinMaxScaler(nn.Module):
    """Scales features to (0, 1) by the smallest and the largest value seen of each.

    Args:
        features: number of features F.

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
        """``[*B, F]`` to ``[*B, F]``; all zero before the first update."""
        return min_max_scale(x, self.low, self.high)
