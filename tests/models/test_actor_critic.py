"""Critics with and without LayerNorm, one by one and stacked."""

from __future__ import annotations

import pytest
import torch

from uavrl.models import Critic


@pytest.mark.parametrize("layer_norm", [False, True])
def test_stacked_critics_give_the_values_and_gradients_of_each(layer_norm: bool) -> None:
    torch.manual_seed(0)
    critics = [Critic(6, 4, [8, 5], layer_norm=layer_norm) for _ in range(2)]
    states, actions = torch.randn(2, 7, 6), torch.randn(2, 7, 4)
    names = dict(critics[0].named_parameters())
    stacked = {name: torch.stack([dict(c.named_parameters())[name].detach() for c in critics]) for name in names}
    for value in stacked.values():
        value.requires_grad_()
    values = critics[0].forward_stacked(stacked, states, actions)
    each = torch.stack([critic(s, a) for critic, s, a in zip(critics, states, actions, strict=True)])
    torch.testing.assert_close(values, each)
    values.square().sum().backward()
    each.square().sum().backward()
    for name, value in stacked.items():
        expected = torch.stack([dict(c.named_parameters())[name].grad for c in critics])
        torch.testing.assert_close(value.grad, expected, msg=name)


def test_each_hidden_layer_is_normalised_before_its_relu() -> None:
    """A hidden layer that gives (1, 3): mean 2, deviation 1, hence (-1, 1), hence (0, 1)."""
    critic = Critic(1, 1, [2], layer_norm=True)
    assert [type(layer).__name__ for layer in critic.net] == ["Linear", "LayerNorm", "ReLU", "Linear"]
    with torch.no_grad():
        critic.net[0].weight.zero_()
        critic.net[0].bias.copy_(torch.tensor([1.0, 3.0]))
        critic.net[3].weight.copy_(torch.tensor([[10.0, 2.0]]))
        critic.net[3].bias.fill_(0.5)
    assert critic(torch.zeros(1, 1), torch.zeros(1, 1)).item() == pytest.approx(2.5, abs=1e-4)
