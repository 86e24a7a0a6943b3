"""Batch renormalisation, and critics whose layers it normalises."""

import itertools
from collections.abc import Mapping
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor, nn

from uavrl.models.actor_critic import Critic
from uavrl_onboard.ranges import Positive, Share, Whole, Widths


class BatchRenorm(nn.Module):
    """Batch renormalisation (Ioffe 2017, arXiv 1702.03275) of the last dimension.

    While training, features are normalised by the mean and the variance of the batch, and the running statistics move.
    After ``warmup`` batches they are corrected towards the running statistics, within bounds. In evaluation the running
    statistics normalise.

    :class:`torchrl.modules.BatchRenorm1d` does the same until twice its warm-up. After that, TorchRL 0.14 multiplies
    the correction by 2, 3 and so on, because its count of batches is not clamped. This class also evaluates K stacked
    layers at once.

    Args:
        features: width of the last dimension.
        momentum: share of a batch in the running statistics.
        max_scale: r_max, the largest factor of the correction; the smallest is its inverse.
        max_shift: d_max, the largest absolute shift of the correction.
        warmup: batches before which nothing is corrected, as in batch normalisation.
        eps: added to variances.

    Examples:
        >>> norm = BatchRenorm(2)
        >>> norm(torch.tensor([[0.0, 5.0], [2.0, 9.0]])).round(decimals=2)
        tensor([[-1., -1.],
                [ 1.,  1.]], grad_fn=<RoundBackward1>)
        >>> norm.running_mean
        tensor([0.0100, 0.0700])
    """

    running_mean: Tensor
    running_var: Tensor
    batches: Tensor

    def __init__(
        self,
        features: int,
        momentum: float = 0.01,
        max_scale: float = 3.0,
        max_shift: float = 5.0,
        warmup: int = 10_000,
        eps: float = 1e-5,
    ) -> None:
        super().__init__()
        self.momentum, self.warmup, self.eps = momentum, warmup, eps
        self.max_scale, self.max_shift = max_scale, max_shift
        self.weight, self.bias = nn.Parameter(torch.ones(features)), nn.Parameter(torch.zeros(features))
        self.register_buffer("running_mean", torch.zeros(features))
        self.register_buffer("running_var", torch.ones(features))
        self.register_buffer("batches", torch.zeros((), dtype=torch.int64))

    @torch.no_grad()
    def reset_parameters(self) -> None:
        """Begins again: no scale, no shift, and the statistics of no batch."""
        for ones in (self.weight, self.running_var):
            ones.fill_(1.0)
        for zeros in (self.bias, self.running_mean, self.batches):
            zeros.zero_()

    def forward(self, inputs: Tensor) -> Tensor:
        """Normalise ``[*B, features]``."""
        rows = inputs.reshape(-1, inputs.shape[-1])
        state = {name: getattr(self, name) for name in ("weight", "bias", "running_mean", "running_var", "batches")}
        return self.forward_stacked(state, rows).reshape(inputs.shape)

    def forward_stacked(self, state: Mapping[str, Tensor], inputs: Tensor) -> Tensor:
        """Normalise ``[*K, B, features]`` by K layers' parameters and statistics, ``[*K, features]`` each."""
        mean, var = state["running_mean"].unsqueeze(-2), state["running_var"].unsqueeze(-2)
        std = (var + self.eps).sqrt()
        normalised = self._by_batch(state, inputs, mean, std) if self.training else (inputs - mean) / std
        return normalised * state["weight"].unsqueeze(-2) + state["bias"].unsqueeze(-2)

    def _by_batch(self, state: Mapping[str, Tensor], inputs: Tensor, mean: Tensor, std: Tensor) -> Tensor:
        """The inputs normalised by their own statistics, which are added to the running ones."""
        own_mean = inputs.mean(-2, keepdim=True)
        own_var = inputs.var(-2, unbiased=False, keepdim=True)
        own_std = (own_var + self.eps).sqrt()
        with torch.no_grad():
            warm = (state["batches"] >= self.warmup)[..., None, None]
            scale = torch.where(warm, (own_std / std).clamp(1 / self.max_scale, self.max_scale), 1.0)
            shift = torch.where(warm, ((own_mean - mean) / std).clamp(-self.max_shift, self.max_shift), 0.0)
            count = inputs.shape[-2]
            state["running_mean"].lerp_(own_mean.squeeze(-2), self.momentum)
            state["running_var"].lerp_(own_var.squeeze(-2) * (count / max(count - 1, 1)), self.momentum)
            state["batches"].add_(1)
        return (inputs - own_mean) / own_std * scale + shift


class BatchRenormCritic(Critic):
    """The action value Q(s, a) of CrossQ (Bhatt et al. 2024, arXiv 1902.05605), which normalises each layer's input.

    Its sizes are those of :class:`~uavrl.models.Critic`, the other arguments those of :class:`BatchRenorm`.

    Examples:
        >>> BatchRenormCritic(105, 4, [64])(torch.zeros(7, 105), torch.zeros(7, 4)).shape
        torch.Size([7, 1])
    """

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Widths = (512, 512),
        *,
        momentum: Share = 0.01,
        max_scale: Annotated[float, Field(ge=1)] = 3.0,
        max_shift: Positive = 5.0,
        warmup: Whole = 10_000,
    ) -> None:
        nn.Module.__init__(self)
        sizes, layers = [observations + actions, *hidden, 1], list[nn.Module]()
        for fan_in, fan_out in itertools.pairwise(sizes):
            layers += [BatchRenorm(fan_in, momentum, max_scale, max_shift, warmup), nn.Linear(fan_in, fan_out)]
            layers += [nn.ReLU()]
        self.net = nn.Sequential(*layers[:-1])
