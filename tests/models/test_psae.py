"""PSAE's network."""

from __future__ import annotations

import torch
from torch import nn

from uavrl.models.psae import PSAE


def test_its_layers_are_those_of_the_specification() -> None:
    layers = [layer for layer in PSAE().modules() if isinstance(layer, nn.Linear)]
    assert [(layer.in_features, layer.out_features) for layer in layers] == [(105, 64), (64, 20), (20, 64), (64, 105)]


def test_features_are_linear_and_reconstructions_follow_from_them() -> None:
    torch.manual_seed(0)
    network = PSAE(6, features=4, hidden=8)
    states = torch.randn(50, 6)
    features, reconstruction = network(states)
    assert (features < 0).any() and (features > 0).any()
    assert torch.equal(features, network.encode(states))
    assert torch.equal(reconstruction, network.decoder(features))


def test_any_batch_shape() -> None:
    network = PSAE(6, features=4, hidden=8)
    states = torch.randn(2, 3, 6)
    torch.testing.assert_close(network.encode(states).reshape(6, 4), network.encode(states.reshape(6, 6)))


def test_states_are_encoded_each_by_itself() -> None:
    network = PSAE(6, features=4, hidden=8)
    states = torch.randn(5, 6)
    torch.testing.assert_close(network.encode(states)[2], network.encode(states[2]))
