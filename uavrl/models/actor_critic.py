"""Actor and critic networks (Chansuparp (2022), §2.3–2.4): plain modules, no TorchRL."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn


def mlp(inputs: int, hidden: Sequence[int], outputs: int) -> nn.Sequential:
    """A fully connected network with ReLU between its layers and none after the last.

    Examples:
        >>> mlp(3, [8], 2)(torch.zeros(5, 3)).shape
        torch.Size([5, 2])
    """
    sizes = [inputs, *hidden, outputs]
    layers: list[nn.Module] = []
    for i, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
        layers.append(nn.Linear(fan_in, fan_out))
        if i < len(sizes) - 2:
            layers.append(nn.ReLU())
    return nn.Sequential(*layers)


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

    def __init__(self, observations: int, actions: int, hidden: Sequence[int] = (400, 300), limit: float = 2.0) -> None:
        super().__init__()
        self.net = mlp(observations, hidden, actions)
        self.limit = limit

    def forward(self, observation: Tensor) -> Tensor:
        """``[*B, observations]`` to ``[*B, actions]``."""
        return self.limit * self.net(observation).tanh()


class Critic(nn.Module):
    """The action value Q(s, a): an MLP over state and action.

    Args:
        observations: width of the state.
        actions: width of the action.
        hidden: widths of the hidden layers.

    Examples:
        >>> Critic(105, 4)(torch.zeros(7, 105), torch.zeros(7, 4)).shape
        torch.Size([7, 1])
    """

    def __init__(self, observations: int, actions: int, hidden: Sequence[int] = (400, 300)) -> None:
        super().__init__()
        self.net = mlp(observations + actions, hidden, 1)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """``[*B, observations]`` and ``[*B, actions]`` to ``[*B, 1]``."""
        return self.net(torch.cat([observation, action], -1))

    def forward_stacked(self, parameters: Mapping[str, Tensor], observation: Tensor, action: Tensor) -> Tensor:
        """Evaluates K critics with stacked parameters in one batched product for each layer.

        Args:
            parameters: ``net.<i>.weight [K, out, in]`` and ``net.<i>.bias [K, out]``.
            observation: ``[K, B, observations]``.
            action: ``[K, B, actions]``.

        Returns:
            ``[K, B, 1]``.
        """
        hidden = torch.cat([observation, action], -1)
        for i, layer in enumerate(self.net):
            if isinstance(layer, nn.Linear):
                weight, bias = parameters[f"net.{i}.weight"], parameters[f"net.{i}.bias"]
                hidden = torch.baddbmm(bias.unsqueeze(-2), hidden, weight.transpose(-1, -2))
            else:
                hidden = layer(hidden)
        return hidden
