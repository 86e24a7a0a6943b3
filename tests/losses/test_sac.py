from __future__ import annotations

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor, TanhNormal

from tests.contracts import ActorCriticLossContract
from uavrl.losses import SACLoss
from uavrl.models import Critic, GaussianActor

SPEC = Bounded(-2.0, 2.0, (2,))


def stochastic_actor() -> ProbabilisticActor:
    return ProbabilisticActor(
        TensorDictModule(GaussianActor(6, 2, (8,)), ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=SPEC,
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -2.0, "high": 2.0},
        return_log_prob=True,
        default_interaction_type=ExplorationType.RANDOM,
    )


def critics() -> list[TensorDictModule]:
    return [TensorDictModule(Critic(6, 2, (8,)), ["observation", "action"], ["state_action_value"]) for _ in range(2)]


class TestSAC(ActorCriticLossContract):
    def make_loss(self, **kwargs: object) -> SACLoss:
        return SACLoss(stochastic_actor(), critics(), action_spec=SPEC, **kwargs)

    def test_critics_keep_the_weights_they_come_with(self) -> None:
        nets = critics()
        expected = [net.module.net[0].weight.detach().clone() for net in nets]
        stacked = SACLoss(stochastic_actor(), nets, action_spec=SPEC).qvalue_network_params["module", "net", "0"]
        assert torch.equal(stacked["weight"], torch.stack(expected))

    def test_value_loss_against_plain_pytorch(self) -> None:
        net, nets = stochastic_actor(), critics()
        loss = SACLoss(net, nets, action_spec=SPEC, alpha_init=0.3, gamma=0.9)
        data = self.make_data()
        torch.manual_seed(3)
        value, metadata = loss.value_loss(data)
        torch.manual_seed(3)
        with torch.no_grad():
            action, log_prob = net.get_dist(data["next"]).rsample_and_log_prob()
            q_t = torch.stack([c.module(data["next", "observation"], action) for c in nets]).squeeze(-1)
            q_t = q_t - 0.3 * log_prob
            goes_on = ~data["next", "terminated"].squeeze(-1)
            target = data["next", "reward"].squeeze(-1) + 0.9 * goes_on * q_t.amin(0)
            q_tm1 = torch.stack([c.module(data["observation"], data["action"]) for c in nets]).squeeze(-1)
        torch.testing.assert_close(value, (q_tm1 - target).square().sum(0).mean())
        torch.testing.assert_close(metadata["target_value"], target)
        torch.testing.assert_close(metadata["pred_value"], q_tm1)
        torch.testing.assert_close(metadata["td_error"], (q_tm1 - target).square())

    def test_actor_loss_is_that_of_torchrl(self) -> None:
        from torchrl.objectives import SACLoss as Theirs

        loss = self.make_loss(alpha_init=0.3)
        data = self.make_data()
        torch.manual_seed(3)
        ours, metadata = loss.actor_loss(data)
        torch.manual_seed(3)
        theirs, expected = Theirs.actor_loss(loss, data)
        torch.testing.assert_close(ours, theirs)
        torch.testing.assert_close(metadata["log_prob"], expected["log_prob"])

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

    def test_stacked_critics_give_what_vmap_gives(self) -> None:
        loss = self.make_loss()
        stacked = loss._values(self.make_data(), loss.qvalue_network_params)
        super(SACLoss, loss)._make_vmap()
        torch.testing.assert_close(loss._values(self.make_data(), loss.qvalue_network_params), stacked)

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
