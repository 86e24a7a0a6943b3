from __future__ import annotations

from typing import ClassVar

import pytest
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import SPEC, actor, critics, ddpg, sac, stochastic_actor, td3
from uavrl.losses import ActorCriticLoss, DDPGLoss, SACLoss, TD3Loss
from uavrl.models import GaussianActor


class TestTD3(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss", "actor_loss")

    def make_loss(self, **kwargs: object) -> TD3Loss:
        return td3(**kwargs)

    def test_time_outs_bootstrap(self) -> None:
        data, loss = self.make_data(), self.make_loss(policy_noise=0.0)
        reward = data["next", "reward"].squeeze(-1)
        data["next", "done"] = torch.ones(5, 1, dtype=torch.bool)
        data["next", "terminated"] = torch.zeros(5, 1, dtype=torch.bool)
        assert not torch.allclose(loss.value_loss(data)[1]["target_value"], reward)
        data["next", "terminated"] = torch.ones(5, 1, dtype=torch.bool)
        torch.testing.assert_close(loss.value_loss(data)[1]["target_value"].squeeze(), reward)


class TestDDPG(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss",)

    def make_loss(self, **kwargs: object) -> DDPGLoss:
        return ddpg(**kwargs)


class TestSAC(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss", "actor_loss")

    def make_loss(self, **kwargs: object) -> SACLoss:
        return sac(**kwargs)

    def test_temperature_falls_while_the_policy_is_too_random(self) -> None:
        """log π = 0 is an entropy above the target of -2: -log α (0 - 2) has the slope 2 in log α."""
        loss = self.make_loss()
        assert loss.target_entropy.item() == -2.0
        (loss.value_loss(self.make_data())[0] + loss.actor_loss(self.make_data())[0]).backward()
        assert loss.log_alpha.grad is None
        loss.alpha_loss(torch.zeros(5)).backward()
        assert [p.grad.item() for p in loss.alpha_params] == [2.0]
        assert self.make_loss(fixed_alpha=True).alpha_params == []

    def test_any_batch_shape(self) -> None:
        loss = self.make_loss(reduction="none")
        data = self.make_data(size=6)
        flat = loss._values(data, loss.qvalue_network_params)
        deep = loss._values(data.reshape(3, 2), loss.qvalue_network_params)
        torch.testing.assert_close(deep.reshape(2, 6), flat)
        assert loss.actor_loss(data.reshape(3, 2))[0].shape == (3, 2)

    def test_actions_stay_within_the_limits(self) -> None:
        actor, data = stochastic_actor(), self.make_data()
        data["observation"] *= 1000
        with set_exploration_type(ExplorationType.RANDOM):
            assert actor(data)["action"].abs().amax() <= 2.0
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            assert torch.equal(actor(data)["action"], actor(data)["action"])


@pytest.mark.parametrize(("kind", "make_actor"), [(TD3Loss, actor), (SACLoss, stochastic_actor)])
def test_another_number_of_critics_is_refused(kind: type[ActorCriticLoss], make_actor: object) -> None:
    with pytest.raises(ValueError, match="two critics"):
        kind(make_actor(), critics()[:1], action_spec=SPEC)


def test_gaussian_actor_bounds_its_deviation() -> None:
    actor = GaussianActor(3, 2, (4,), log_scale=(-1.0, 1.0))
    torch.nn.init.constant_(actor.net[-1].bias, 50.0)
    _, scale = actor(torch.zeros(1, 3))
    torch.testing.assert_close(scale, torch.full((1, 2), torch.e))
