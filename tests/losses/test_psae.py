"""PSAE's loss (Eq. 3.3) on numbers worked out by hand, and under the contract of losses."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from tests.helpers.contracts import LossContract
from uavrl.errors import UavrlError
from uavrl.losses.psae import PSAELoss
from uavrl.models import PSAE


class Fixed(torch.nn.Module):
    """An autoencoder whose every output is known: features (x, 2), reconstruction 2 x."""

    def __init__(self) -> None:
        super().__init__()
        self.gain = torch.nn.Parameter(torch.tensor(2.0))

    def forward(self, states: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.cat([states, torch.full_like(states, 2.0)], -1), self.gain * states


def triple(before: float, anchor: float, after: float) -> TensorDict:
    data = {"observation": anchor, "previous": {"observation": before}, "next": {"observation": after}}
    return TensorDict(data).apply(lambda x: torch.as_tensor(x).reshape(1, 1), batch_size=[1])


def test_the_loss_on_numbers_worked_out_by_hand() -> None:
    # errors: 1² + 0² + 3²; cos((0, 2), (1, 2)) = 4 / (2 √5), cos((0, 2), (3, 2)) = 4 / (2 √13)
    similarity = 2 / math.sqrt(5) + 2 / math.sqrt(13)
    for tradeoff, expected in ((0.7, 0.7 * 10 - 0.3 * similarity), (0.0, -similarity), (1.0, 10.0)):
        loss, metadata = PSAELoss(Fixed(), tradeoff=tradeoff).psae_loss(triple(1.0, 0.0, 3.0))
        assert metadata["reconstruction_error"].item() == 10.0
        assert metadata["similarity"].item() == pytest.approx(similarity)
        assert loss.item() == pytest.approx(expected)


class Narrow(Fixed):
    def forward(self, states: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return states, self.gain * states[..., 1:]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: PSAELoss(PSAE(6), tradeoff=1.5), r"tradeoff must be in \[0, 1\], got 1.5"),
        (lambda: PSAELoss(TensorDictModule(PSAE(6), ["observation"], ["features"])), "to features and reconstruction"),
        (lambda: PSAELoss(PSAE(6)).make_value_estimator(), "knows no values"),
        (
            lambda: PSAELoss(Narrow()).psae_loss(TestPSAELoss().make_data()),
            r"of the states' shape \[3, 5, 6\], got \[3, 5, 5\]",
        ),
    ],
)
def test_what_does_not_fit_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises((ValueError, UavrlError), match=message):
        call()


def test_it_trains_the_networks_own_parameters() -> None:
    network = PSAE(6)
    loss = PSAELoss(network)
    optimizer = torch.optim.SGD(loss.parameters(), 0.1)
    before = network.encoder[0].weight.clone()
    loss.psae_loss(TestPSAELoss().make_data())[0].backward()
    optimizer.step()
    assert not torch.equal(network.encoder[0].weight, before)


class TestPSAELoss(LossContract):
    methods: ClassVar[dict[str, str]] = {"psae_loss": "network"}
    compiled: ClassVar[tuple[str, ...]] = ("psae_loss",)

    def make_loss(self, **kwargs: object) -> PSAELoss:
        return PSAELoss(PSAE(self.observations, features=3, hidden=8), **kwargs)

    def groups(self, loss: torch.nn.Module) -> dict[str, list[torch.Tensor]]:
        return {"network": list(loss.network_params.values(True, True))}

    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        generator = torch.Generator().manual_seed(0)
        before, anchor, after = torch.randn(3, size, self.observations, generator=generator, dtype=dtype)
        data = {"observation": anchor, "previous": {"observation": before}, "next": {"observation": after}}
        return TensorDict(data, [size])

    def test_the_actors_metadata_is_detached(self) -> None:
        """Here: the loss's own, there being no actor."""
        metadata = self.make_loss().psae_loss(self.make_data())[1]
        assert len(metadata) == 2 and not any(value.requires_grad for value in metadata.values())

    def test_forward_gives_each_loss(self) -> None:
        loss = self.make_loss()
        assert sorted(loss(self.make_data()).keys()) == sorted(loss.out_keys)

    def test_keyword_arguments(self) -> None:
        loss, data = self.make_loss(), self.make_data()
        values = loss(**{"_".join(k) if isinstance(k, tuple) else k: v for k, v in data.items(True, True)})
        expected = loss(data)
        for key, value in zip(loss.out_keys, values, strict=True):
            torch.testing.assert_close(value, expected[key])

    def test_keys_can_be_renamed(self, method: str) -> None:
        data, renamed = self.make_data(), self.make_data()
        renamed["before"] = renamed.pop("previous")["observation"]
        renamed["state"] = renamed.pop("observation")
        loss = self.seeded_loss()
        loss.set_keys(observation="state", previous_observation="before")
        assert torch.equal(self.evaluate(loss, method, renamed), self.evaluate(self.seeded_loss(), method, data))
