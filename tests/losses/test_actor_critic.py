from __future__ import annotations

import copy

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded

from tests.contracts import ActorCriticLossContract
from uavrl.losses import DDPGLoss, TD3Loss
from uavrl.models import Actor, Critic


def actor(limit: float = 2.0) -> TensorDictModule:
    return TensorDictModule(Actor(6, 2, (8,), limit), ["observation"], ["action"])


def critic() -> TensorDictModule:
    return TensorDictModule(Critic(6, 2, (8,)), ["observation", "action"], ["state_action_value"])


class TestTD3(ActorCriticLossContract):
    def make_loss(self, **kwargs: object) -> TD3Loss:
        return TD3Loss(actor(), [critic(), critic()], action_spec=Bounded(-2.0, 2.0, (2,)), **kwargs)

    def test_critics_keep_the_weights_they_come_with(self) -> None:
        critics = [critic(), critic()]
        expected = [c.module.net[0].weight.detach().clone() for c in critics]
        loss = TD3Loss(actor(), critics, action_spec=Bounded(-2.0, 2.0, (2,)))
        stacked = loss.qvalue_network_params["module", "net", "0", "weight"]
        assert torch.equal(stacked[0], expected[0])
        assert torch.equal(stacked[1], expected[1])
        assert not torch.equal(expected[0], expected[1])

    def test_value_loss_against_plain_pytorch(self) -> None:
        """Eq. 2.10–2.12 written out; noise 0 makes the target deterministic."""
        net, critics = actor(), [critic(), critic()]
        loss = TD3Loss(net, critics, action_spec=Bounded(-2.0, 2.0, (2,)), policy_noise=0.0)
        data = self.make_data()
        with torch.no_grad():
            action = net.module(data["next", "observation"])
            value = torch.minimum(*(c.module(data["next", "observation"], action) for c in critics))
            target = data["next", "reward"] + 0.99 * ~data["next", "terminated"] * value
            errors = [(c.module(data["observation"], data["action"]) - target) ** 2 for c in critics]
        torch.testing.assert_close(loss.value_loss(data)[0], (errors[0] + errors[1]).mean())

    def test_actor_loss_against_plain_pytorch(self) -> None:
        net, critics = actor(), [critic(), critic()]
        loss = TD3Loss(net, critics, action_spec=Bounded(-2.0, 2.0, (2,)))
        data = self.make_data()
        expected = -critics[0].module(data["observation"], net.module(data["observation"])).mean()
        torch.testing.assert_close(loss.actor_loss(data)[0], expected)

    def test_target_noise_is_scaled_by_half_the_action_range(self) -> None:
        loss = TD3Loss(actor(), [critic(), critic()], action_spec=Bounded(-2.0, 2.0, (2,)))
        assert loss.policy_noise.tolist() == pytest.approx([0.4, 0.4])
        assert loss.noise_clip.tolist() == [1.0, 1.0]

    def test_time_outs_bootstrap(self) -> None:
        data = self.make_data()
        data["next", "done"] = torch.ones(5, 1, dtype=torch.bool)
        data["next", "terminated"] = torch.zeros(5, 1, dtype=torch.bool)
        loss = self.make_loss(policy_noise=0.0)
        target = loss.value_loss(data)[1]["target_value"]
        assert not torch.allclose(target, data["next", "reward"].squeeze(-1))
        data["next", "terminated"] = torch.ones(5, 1, dtype=torch.bool)
        target = loss.value_loss(data)[1]["target_value"]
        torch.testing.assert_close(target.squeeze(), data["next", "reward"].squeeze(-1))

    def test_stacked_critics_give_what_vmap_gives(self) -> None:
        class OtherCritic(torch.nn.Module):
            """Not the library's: the loss falls back to vmap."""

            def __init__(self, inner: Critic) -> None:
                super().__init__()
                self.net = inner.net

            def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
                return self.net(torch.cat([observation, action], -1))

        net, critics = actor(), [critic(), critic()]
        others = [TensorDictModule(OtherCritic(c.module), c.in_keys, c.out_keys) for c in copy.deepcopy(critics)]
        results: list[tuple[torch.Tensor, list[torch.Tensor]]] = []
        for nets in (critics, others):
            loss = TD3Loss(copy.deepcopy(net), nets, action_spec=Bounded(-2.0, 2.0, (2,)))
            torch.manual_seed(0)
            value = loss.value_loss(self.make_data())[0]
            value.backward()
            results.append((value, [p.grad for p in loss.critic_network_params.values(True, True)]))
        torch.testing.assert_close(results[0][0], results[1][0])
        torch.testing.assert_close(results[0][1], results[1][1])

    def test_another_number_of_critics_is_refused(self) -> None:
        with pytest.raises(ValueError, match="two critics"):
            TD3Loss(actor(), [critic()], action_spec=Bounded(-2.0, 2.0, (2,)))


class TestDDPG(ActorCriticLossContract):
    def make_loss(self, **kwargs: object) -> DDPGLoss:
        return DDPGLoss(actor(), critic(), **kwargs)

    def test_value_loss_against_plain_pytorch(self) -> None:
        """Eq. 2.8 written out."""
        net, value = actor(), critic()
        loss = DDPGLoss(net, value)
        data = self.make_data()
        with torch.no_grad():
            following = value.module(data["next", "observation"], net.module(data["next", "observation"]))
            target = data["next", "reward"] + 0.99 * ~data["next", "terminated"] * following
            expected = ((value.module(data["observation"], data["action"]) - target) ** 2).mean()
        torch.testing.assert_close(loss.value_loss(data)[0], expected)
