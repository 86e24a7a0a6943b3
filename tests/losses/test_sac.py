from __future__ import annotations

from typing import ClassVar

import pytest
import torch
from torchrl.data import Bounded
from torchrl.envs.utils import ExplorationType, set_exploration_type

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import critics, stochastic_actor
from uavrl.losses import SACLoss
from uavrl.models import GaussianActor

SPEC = Bounded(-2.0, 2.0, (2,))


class TestSAC(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss", "actor_loss")

    def make_loss(self, **kwargs: object) -> SACLoss:
        return SACLoss(stochastic_actor(), critics(), action_spec=SPEC, **kwargs)

    def test_temperature_falls_while_the_policy_is_too_random(self) -> None:
        """log π = 0 is an entropy above the target of -2: -log α (0 - 2) has the slope 2 in log α."""
        loss = self.make_loss()
        assert loss.target_entropy.item() == -2.0
        loss.alpha_loss(torch.zeros(5)).backward()
        assert [p.grad.item() for p in loss.alpha_params] == [2.0]
        assert self.make_loss(fixed_alpha=True).alpha_params == []

    def test_losses_leave_the_temperature_alone(self) -> None:
        loss = self.make_loss()
        (loss.value_loss(self.make_data())[0] + loss.actor_loss(self.make_data())[0]).backward()
        assert loss.log_alpha.grad is None

    def test_any_batch_shape(self) -> None:
        loss = self.make_loss(reduction="none")
        data = self.make_data(size=6)
        flat = loss._values(data, loss.qvalue_network_params)
        deep = loss._values(data.reshape(3, 2), loss.qvalue_network_params)
        torch.testing.assert_close(deep.reshape(2, 6), flat)
        assert loss.actor_loss(data.reshape(3, 2))[0].shape == (3, 2)

    def test_actions_stay_within_the_limits(self) -> None:
        actor = stochastic_actor()
        data = self.make_data()
        data["observation"] *= 1000
        with set_exploration_type(ExplorationType.RANDOM):
            assert actor(data)["action"].abs().amax() <= 2.0
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            assert torch.equal(actor(data)["action"], actor(data)["action"])

    def test_another_number_of_critics_is_refused(self) -> None:
        with pytest.raises(ValueError, match="two critics"):
            SACLoss(stochastic_actor(), critics()[:1], action_spec=SPEC)


def test_gaussian_actor_bounds_its_deviation() -> None:
    actor = GaussianActor(3, 2, (4,), log_scale=(-1.0, 1.0))
    torch.nn.init.constant_(actor.net[-1].bias, 50.0)
    _, scale = actor(torch.zeros(1, 3))
    torch.testing.assert_close(scale, torch.full((1, 2), torch.e))
