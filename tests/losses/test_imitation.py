"""Staying near a guide: the value by hand, where the gradient goes, and what is said of a batch without a guide."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torchrl.data import Bounded
from torchrl.modules import MLP

from tests.helpers.contracts import ActorCriticLossContract
from uavrl.losses import DDPGLoss, Fork, Imitation, SACLoss, TD3Loss
from uavrl.losses.imitation import distance_to_guide
from uavrl.models import Actor, Critic, RewardNet, SystemNet


def make_td3(**options: Any) -> TD3Loss:
    critics = [TensorDictModule(Critic(6, 2), ["observation", "action"], ["state_action_value"]) for _ in range(2)]
    actor = TensorDictModule(Actor(6, 2), ["observation"], ["action"])
    return TD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (2,)), **options)


class MLPCritic(torch.nn.Module):
    """TorchRL's network, of state and action end to end."""

    def __init__(self) -> None:
        super().__init__()
        self.mlp = MLP(in_features=8, out_features=1, num_cells=[16])

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return self.mlp(torch.cat([observation, action], -1))


class TestContract(ActorCriticLossContract):
    def make_loss(self, **options: Any) -> Imitation:
        return Imitation(make_td3(**options), limit=2.0)

    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        data = super().make_data(dtype, size)
        return data.set("guide_action", data["action"].flip(-1))


def test_the_distance_by_hand() -> None:
    """Differences 1 and -3 of actions up to 2: (0.5² + 1.5²) / 2 = 1.25."""
    told = distance_to_guide(torch.tensor([[1.0, -1.0]]), torch.tensor([[0.0, 2.0]]), 2.0)
    assert told.tolist() == [1.25]


def test_the_term_has_the_size_of_the_objective() -> None:
    data = TestContract().make_data()
    loss = TestContract().seeded_loss(reduction="none")
    loss.weight = 0.7
    plain, metadata = loss.base.actor_loss(data)
    actions = loss.act(data)["action"]
    distance = distance_to_guide(actions, data["guide_action"], 2.0)
    torch.testing.assert_close(loss.actor_loss(data)[0], plain + 0.7 * plain.abs().mean() * distance)
    torch.testing.assert_close(loss.actor_loss(data)[1]["guide_distance"], distance)
    assert set(metadata) < set(loss.actor_loss(data)[1])


def test_alone_it_leads_to_the_guide() -> None:
    torch.manual_seed(0)
    loss = Imitation(make_td3(), limit=2.0, weight=1e4)
    data = TestContract().make_data(size=64).set("guide_action", torch.tensor([1.0, -0.5]).expand(64, 2))
    adam = torch.optim.Adam(list(loss.actor_network_params.values(True, True)), lr=1e-2)
    for _ in range(200):
        adam.zero_grad()
        loss.actor_loss(data)[0].backward()
        adam.step()
    torch.testing.assert_close(loss.act(data)["action"], data["guide_action"], atol=0.2, rtol=0.0)


def test_without_a_guide_it_says_what_is_missing() -> None:
    loss = TestContract().make_loss()
    with pytest.raises(KeyError, match="Imitation reads 'guide_action'"):
        loss.actor_loss(TestContract().make_data().exclude("guide_action"))
    loss.set_keys(guide_action="advice")
    assert "advice" in loss.in_keys
    loss.actor_loss(TestContract().make_data().rename_key_("guide_action", "advice"))


@pytest.mark.parametrize("algorithm", ["ddpg", "sac", "foreign"])
def test_it_attaches_to_other_losses_and_to_critics_that_are_not_ours(algorithm: str) -> None:
    torch.manual_seed(0)
    spec = Bounded(-2.0, 2.0, (2,))
    kind = {"ddpg": DDPGLoss, "sac": SACLoss, "foreign": TD3Loss}[algorithm]
    network: torch.nn.Module = MLP(in_features=6, out_features=4 if kind is SACLoss else 2, num_cells=[16])
    if kind is SACLoss:  # mean and deviation
        network = torch.nn.Sequential(network, NormalParamExtractor())
    critics = [
        TensorDictModule(MLPCritic(), ["observation", "action"], ["state_action_value"])
        for _ in range(kind.num_critics)
    ]
    loss = Imitation(kind.of_networks(kind.policy_of(network, spec), critics, spec), limit=2.0)
    data = TestContract().make_data()
    with torch.random.fork_rng():  # SAC draws its action: the same one both times
        plain = loss.base.actor_loss(data)[0]
    enhanced = loss.actor_loss(data)
    assert enhanced[1]["guide_distance"].shape == data.batch_size
    assert enhanced[0].isfinite() and enhanced[0] > plain
    enhanced[0].backward()
    assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in loss.actor_network_params.values(True, True))


def test_fork_goes_around_it() -> None:
    nets = {"system_network": SystemNet(6, 2), "reward_network": RewardNet(6, 2), "observations": 6}
    loss = Fork(TestContract().make_loss(), **nets, max_reward=500.0)
    loss.update_gate(0.01)
    value, metadata = loss.actor_loss(TestContract().make_data())
    assert value.isfinite() and {"fork_term", "guide_distance"} <= set(metadata)
