"""Actor and critic networks (Chansuparp (2022), §2.3–2.4): plain modules, no TorchRL."""

import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn
from torch.func import functional_call

from uavrl_onboard.ranges import Widths
from uavrl_onboard.vehicle import VEHICLE


def mlp(inputs: int, hidden: Sequence[int], outputs: int, *, layer_norm: bool = False) -> nn.Sequential:
    """A fully connected network with ReLU between its layers and none after the last.

    With ``layer_norm`` each hidden layer is normalised before its ReLU (Ba et al. 2016, arXiv:1607.06450).

    Examples:
        >>> mlp(3, [8], 2)(torch.zeros(5, 3)).shape
        torch.Size([5, 2])
    """
    sizes = [inputs, *hidden, outputs]
    layers: list[nn.Module] = []
    for i, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
        layers.append(nn.Linear(fan_in, fan_out))
        if i < len(sizes) - 2:
            layers += [nn.LayerNorm(fan_out), nn.ReLU()] if layer_norm else [nn.ReLU()]
    return nn.Sequential(*layers)


def as_weights(inputs: Tensor, weight: Any) -> Tensor:
    """Return inputs in the type of a network's weights, which were made with another default type than the data.

    Examples:
        >>> as_weights(torch.zeros(2), torch.zeros(1, dtype=torch.float64)).dtype
        torch.float64
    """
    return inputs if inputs.dtype == weight.dtype else inputs.to(weight.dtype)


def joined(parts: Sequence[Tensor]) -> Tensor:
    """Return parts ``[*B, ...]`` end to end.

    Examples:
        >>> joined([torch.zeros(5, 2), torch.zeros(5, 1)]).shape
        torch.Size([5, 3])
    """
    return parts[0] if len(parts) == 1 else torch.cat(list(parts), -1)


class Actor(nn.Module):
    """The deterministic policy μ(s): an MLP, squashed by tanh to [-limit, limit].

    Args:
        observations: width of the state.
        actions: width of the action.
        hidden: widths of the hidden layers.
        limit: the largest action (a_high).

    Examples:
        >>> Actor(105, 4)(torch.zeros(7, 105)).shape
        torch.Size([7, 4])
    """

    def __init__(
        self, observations: int, actions: int, hidden: Widths = (400, 300), limit: float = VEHICLE.velocity_limit
    ) -> None:
        super().__init__()
        self.net = mlp(observations, hidden, actions)
        self.limit = limit

    def forward(self, *state: Tensor) -> Tensor:
        """``[*B, observations]``, in one part or several, to ``[*B, actions]``."""
        return self.limit * self.net(as_weights(joined(state), self.net[0].weight)).tanh()


class GaussianActor(nn.Module):
    """The stochastic policy of SAC before it is squashed: an MLP that gives mean and deviation of a normal.

    Its sizes are those of :class:`Actor`; the logarithm of the deviation is clamped to the bounds ``log_scale``.

    Examples:
        >>> loc, scale = GaussianActor(105, 4)(torch.zeros(7, 105))
        >>> loc.shape, scale.shape
        (torch.Size([7, 4]), torch.Size([7, 4]))
    """

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Widths = (400, 300),
        log_scale: tuple[float, float] = (-5.0, 2.0),
    ) -> None:
        super().__init__()
        self.net = mlp(observations, hidden, 2 * actions)
        self.log_scale = log_scale

    def forward(self, *state: Tensor) -> tuple[Tensor, Tensor]:
        """``[*B, observations]``, in one part or several, to mean and deviation, each ``[*B, actions]``."""
        loc, log_scale = self.net(as_weights(joined(state), self.net[0].weight)).chunk(2, -1)
        return loc, log_scale.clamp(*self.log_scale).exp()


class Critic(nn.Module):
    """The action value Q(s, a): an MLP over state and action.

    Its sizes are those of :class:`Actor`; with ``layer_norm`` each hidden layer is normalised (Hiraoka et al. 2022,
    arXiv:2110.02034).

    Examples:
        >>> Critic(105, 4)(torch.zeros(7, 105), torch.zeros(7, 4)).shape
        torch.Size([7, 1])
    """

    def __init__(
        self, observations: int, actions: int, hidden: Widths = (400, 300), *, layer_norm: bool = False
    ) -> None:
        super().__init__()
        self.net = mlp(observations + actions, hidden, 1, layer_norm=layer_norm)

    def forward(self, *state_and_action: Tensor) -> Tensor:
        """``[*B, observations]``, in one part or several, and ``[*B, actions]`` to ``[*B, 1]``."""
        return self.net(as_weights(joined(state_and_action), self.net[0].weight))

    def forward_stacked(self, parameters: Mapping[str, Tensor], *state_and_action: Tensor) -> Tensor:
        """Evaluates K critics with stacked parameters, linear layers in one batched product.

        Args:
            parameters: ``net.<i>.weight [K, out, in]``, ``net.<i>.bias [K, out]``, and whatever other layers have.
            *state_and_action: ``[K, B, observations]``, in one part or several, and ``[K, B, actions]``.

        Returns:
            ``[K, B, 1]``.
        """
        inputs = as_weights(joined(state_and_action), parameters["net.0.weight"])
        return _stacked(self.net, _below("net", parameters), inputs)


def _stacked(layer: nn.Module, parameters: Mapping[str, Tensor], inputs: Tensor) -> Tensor:
    """The outputs of a layer with stacked parameters ``[K, ...]`` for inputs ``[K, B, in]``."""
    if type(layer) is nn.Sequential:
        for name, child in layer._modules.items():
            inputs = _stacked(child, _below(name, parameters), inputs)
        return inputs
    if "forward_stacked" in vars(type(layer)):
        return layer.forward_stacked(parameters, inputs)  # type: ignore[operator]
    if type(layer) is nn.Linear and parameters.keys() == {"weight", "bias"}:
        return stacked_linear(inputs, parameters["weight"], parameters["bias"])
    if parameters:
        return torch.vmap(partial(functional_call, layer))(dict(parameters), (inputs,))
    return layer(inputs)


def stacked_linear(inputs: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Return the outputs ``[K, B, out]`` of K linear layers: ``weight [K, out, in]``, ``bias [K, out]``."""
    return _StackedLinear.apply(*_autocast(inputs, weight, bias))


def _autocast(*tensors: Tensor) -> tuple[Tensor, ...]:
    """The tensors in the type of ``torch.autocast``, where it is on, so that forward and backward agree."""
    device = tensors[0].device.type
    if not torch.is_autocast_enabled(device) or any(tensor.dtype == torch.float64 for tensor in tensors):
        return tensors
    return tuple(tensor.to(torch.get_autocast_dtype(device)) for tensor in tensors)


def _below(name: str, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The entries ``name.*`` without their prefix."""
    prefix = f"{name}."
    return {key.removeprefix(prefix): value for key, value in parameters.items() if key.startswith(prefix)}


class _StackedLinear(torch.autograd.Function):
    """``x W^T + b`` for K layers at once; unlike ``baddbmm`` alone, its weights' gradients are contiguous."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """``[K, B, in]``, ``[K, out, in]`` and ``[K, out]`` to ``[K, B, out]``."""
        ctx.save_for_backward(inputs, weight)
        return torch.baddbmm(bias.unsqueeze(-2), inputs, weight.transpose(-1, -2))

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
        """The three gradients that are asked for."""
        inputs, weight = ctx.saved_tensors
        of_inputs = torch.bmm(gradient, weight) if ctx.needs_input_grad[0] else None
        of_weight = torch.bmm(gradient.transpose(-1, -2), inputs) if ctx.needs_input_grad[1] else None
        of_bias = gradient.sum(-2) if ctx.needs_input_grad[2] else None
        return of_inputs, of_weight, of_bias
