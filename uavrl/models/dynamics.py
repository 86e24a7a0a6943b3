"""Models of the environment that FORK learns (Chansuparp (2022), §2.5): plain modules, no TorchRL."""

import torch
from torch import Tensor, nn

from uavrl.models.actor_critic import as_weights, mlp
from uavrl_onboard.ranges import Widths


class SystemNet(nn.Module):
    """Predicts the next state from state and action.

    Weights start Xavier-uniform and biases at 0.001, as FORK's authors have them.

    Args:
        observations: width of the state.
        actions: width of the action.
        hidden: widths of the hidden layers.

    Examples:
        >>> SystemNet(105, 4)(torch.zeros(7, 105), torch.zeros(7, 4)).shape
        torch.Size([7, 105])
    """

    def __init__(self, observations: int, actions: int, hidden: Widths = (400, 300)) -> None:
        super().__init__()
        self.net = mlp(observations + actions, hidden, observations)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Draws new weights."""
        for layer in self.net:
            if isinstance(layer, nn.Linear):
                nn.init.xavier_uniform_(layer.weight)
                nn.init.constant_(layer.bias, 0.001)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """``[*B, observations]`` and ``[*B, actions]`` to ``[*B, observations]``."""
        return self.net(as_weights(torch.cat([observation, action], -1), self.net[0].weight))


class RewardNet(nn.Module):
    """Predicts the reward from state, next state and action; its sizes are those of :class:`SystemNet`.

    Examples:
        >>> RewardNet(105, 4)(torch.zeros(7, 105), torch.zeros(7, 105), torch.zeros(7, 4)).shape
        torch.Size([7, 1])
    """

    def __init__(self, observations: int, actions: int, hidden: Widths = (256, 256)) -> None:
        super().__init__()
        self.net = mlp(2 * observations + actions, hidden, 1)

    def forward(self, observation: Tensor, next_observation: Tensor, action: Tensor) -> Tensor:
        """Two ``[*B, observations]`` and ``[*B, actions]`` to ``[*B, 1]``."""
        inputs = torch.cat([observation, next_observation, action], -1)
        return self.net(as_weights(inputs, self.net[0].weight))
