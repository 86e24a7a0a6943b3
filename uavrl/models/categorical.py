"""Critics that give a distribution of the value, whose dense layers have rows of norm 1."""

import itertools
from collections.abc import Mapping
from typing import Annotated, Any

import torch
from pydantic import Field
from torch import Tensor, nn

from uavrl.models.actor_critic import Critic, stacked_linear
from uavrl.models.batch_renorm import BatchRenorm
from uavrl_onboard.ranges import Share, Widths


def unit_rows(weight: Tensor) -> Tensor:
    """Return the weights ``[*K, out, in]`` of dense layers with each row divided by its Euclidean norm.

    Examples:
        >>> unit_rows(torch.tensor([[3.0, 4.0], [0.0, -2.0]]))
        tensor([[ 0.6000,  0.8000],
                [ 0.0000, -1.0000]])
    """
    return nn.functional.normalize(weight, dim=-1)


class UnitNormLinear(nn.Linear):
    """A dense layer whose weights for each of its outputs have norm 1 (Palenicek et al. 2026, arXiv 2509.25174).

    Its weights are drawn so. A step of an optimiser lengthens them: call
    :meth:`uavrl.losses.ActorCriticLoss.project_weights` after each one, as uavrl's trainer does. Dividing by the norm
    in ``forward`` instead would not be the same. Batch normalisation makes the output independent of the norm, so the
    norm would only grow, and each step would turn the weights less than the one before.

    Examples:
        >>> UnitNormLinear(3, 2).weight.norm(dim=-1).round(decimals=5)
        tensor([1., 1.], grad_fn=<RoundBackward1>)
    """

    @torch.no_grad()
    def reset_parameters(self) -> None:
        """Draw orthogonal weights, and scale each row to norm 1; the bias is 0."""
        nn.init.orthogonal_(self.weight)
        self.weight.copy_(unit_rows(self.weight))
        if self.bias is not None:
            self.bias.zero_()

    def forward_stacked(self, parameters: Mapping[str, Tensor], inputs: Tensor) -> Tensor:
        """Map ``[K, B, in]`` to ``[K, B, out]`` by K layers' ``weight [K, out, in]`` and ``bias [K, out]``, if any."""
        weight = parameters["weight"]
        bias = parameters["bias"] if "bias" in parameters else weight.new_zeros(weight.shape[:-1])
        return stacked_linear(inputs, weight, bias)


class CategoricalCritic(Critic):
    """The critic of XQC (Palenicek et al. 2026, arXiv 2509.25174): logits of a distribution of the action value.

    Its input is batch-normalised. Each hidden layer is a :class:`UnitNormLinear` without bias, batch normalisation and
    ReLU, and the last layer a :class:`UnitNormLinear` with a bias. The values that the logits belong to are those of
    the loss, :class:`~uavrl.losses.XQCLoss`. Batch normalisation is :class:`BatchRenorm` without its correction.

    Args:
        observations: width of the state.
        actions: width of the action.
        hidden: widths of the hidden layers.
        atoms: number of values that have a probability.
        momentum: share of a batch in the running statistics.

    Examples:
        >>> CategoricalCritic(105, 4, [64], atoms=51)(torch.zeros(7, 105), torch.zeros(7, 4)).shape
        torch.Size([7, 51])
    """

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Widths = (512, 512, 512, 512),
        *,
        atoms: Annotated[int, Field(ge=2, le=10_000)] = 101,
        momentum: Share = 0.01,
    ) -> None:
        nn.Module.__init__(self)
        plain: dict[str, Any] = {"momentum": momentum, "max_scale": 1.0, "max_shift": 0.0, "warmup": 0, "eps": 1e-3}
        sizes = [observations + actions, *hidden]
        layers: list[nn.Module] = [BatchRenorm(sizes[0], **plain)]
        for fan_in, fan_out in itertools.pairwise(sizes):
            layers += [UnitNormLinear(fan_in, fan_out, bias=False), BatchRenorm(fan_out, **plain), nn.ReLU()]
        self.net = nn.Sequential(*layers, UnitNormLinear(sizes[-1], atoms))
