"""PSAE's network."""

from __future__ import annotations

import torch
from torch import nn

from uavrl.models import PSAE


def test_its_layers_are_those_of_the_specification() -> None:
    layers = [layer for layer in PSAE().modules() if isinstance(layer, nn.Linear)]
    assert [(layer.in_features, layer.out_features) for layer in layers] == [(105, 64), (64, 20), (20, 64), (64, 105)]


def test_features_are_linear_each_states_own_and_reconstructions_follow_from_them() -> None:
    torch.manual_seed(0)
    network = PSAE(6, features=4, hidden=8)
    states = torch.randn(10, 5, 6)
    features, reconstruction = network(states)
    assert (features < 0).any() and (features > 0).any()
    assert torch.equal(features, network.encode(states))
    assert torch.equal(reconstruction, network.decoder(features))
    torch.testing.assert_close(features[3, 2], network.encode(states[3, 2]))
