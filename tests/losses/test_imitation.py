"""Behaviour cloning: the value by hand, where the gradient goes, and the error for a batch without actions to clone."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torchrl.modules import MLP

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import SPEC, fork, td3
from uavrl.errors import UavrlError
from uavrl.losses import ActionRate, DDPGLoss, Imitation, SACLoss, TD3Loss
from uavrl.losses.imitation import action_distance
from uavrl.training.update import ActorCriticStepper


class MLPCritic(torch.nn.Module):
    """TorchRL's network, of state and action end to end."""

    def __init__(self) -> None:
        super().__init__()
        self.mlp = MLP(in_features=8, out_features=1, num_cells=[16])

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return self.mlp(torch.cat([observation, action], -1))


class TestContract(ActorCriticLossContract):
    def make_loss(self, **options: Any) -> Imitation:
        return Imitation(td3(**options), limit=2.0)

    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        data = super().make_data(dtype, size)
        return data.set("demonstrator_action", data["action"].flip(-1))


def test_the_distance_by_hand() -> None:
    """Differences 1 and -3 of actions up to 2: (0.5² + 1.5²) / 2 = 1.25."""
    distance = action_distance(torch.tensor([[1.0, -1.0]]), torch.tensor([[0.0, 2.0]]), 2.0)
    assert distance.tolist() == [1.25]


def test_the_term_has_the_size_of_the_objective() -> None:
    data = TestContract().make_data()
    loss = TestContract().seeded_loss(reduction="none")
    loss.weight.fill_(0.7)
    plain, metadata = loss.base.actor_loss(data)
    distance = action_distance(loss.act(data)["action"], data["demonstrator_action"], 2.0)
    torch.testing.assert_close(loss.actor_loss(data)[0], plain + 0.7 * plain.abs().mean() * distance)
    torch.testing.assert_close(loss.actor_loss(data)[1]["demonstrator_distance"], distance)
    assert set(metadata) < set(loss.actor_loss(data)[1])


def test_the_weight_decays_by_the_steps_of_whole_episodes() -> None:
    """From 4 to 0.25 in 100 steps, hence 1 after 50; a loss that is restored goes on from there."""
    loss = Imitation(td3(), limit=2.0, weight=4.0, final_weight=0.25, decay_steps=100)
    episode = TensorDict({}, [50])
    loss.observe(episode)
    assert loss.weight.item() == pytest.approx(1.0)
    restored = Imitation(td3(), limit=2.0, weight=4.0, final_weight=0.25, decay_steps=100)
    restored.load_state_dict(loss.state_dict())
    assert restored.weight.item() == pytest.approx(1.0)
    for _ in range(3):
        restored.observe(episode)
    assert restored.weight.item() == pytest.approx(0.25)
    assert restored.diagnostics()["imitation_weight"] == pytest.approx(0.25)


def test_a_decay_from_nothing_is_refused() -> None:
    with pytest.raises(UavrlError, match="weight must be above 0 to decay to a final_weight, which is"):
        Imitation(td3(), weight=0, final_weight=0.2)


@pytest.mark.parametrize("execution", ["eager", "captured", "compiled"])
def test_an_update_takes_the_weight_of_now(execution: Any) -> None:
    loss = Imitation(td3(), limit=2.0, weight=1.0, final_weight=100.0, decay_steps=10)
    stepper = ActorCriticStepper(loss, policy_delay=1, execution=execution)
    data = TestContract().make_data()
    before = stepper.step(None, data.clone())["loss_actor"].item()
    loss.observe(TensorDict({}, [10]))
    after = stepper.step(None, data.clone())["loss_actor"].item()
    assert after > 10 * abs(before)


def test_alone_it_leads_to_the_guide() -> None:
    torch.manual_seed(0)
    loss = Imitation(td3(), limit=2.0, weight=1e4)
    data = TestContract().make_data(size=64).set("demonstrator_action", torch.tensor([1.0, -0.5]).expand(64, 2))
    adam = torch.optim.Adam(list(loss.actor_network_params.values(True, True)), lr=1e-2)
    for _ in range(200):
        adam.zero_grad()
        loss.actor_loss(data)[0].backward()
        adam.step()
    torch.testing.assert_close(loss.act(data)["action"], data["demonstrator_action"], atol=0.2, rtol=0.0)


def test_a_batch_without_actions_to_clone_is_refused() -> None:
    loss = TestContract().make_loss()
    with pytest.raises(KeyError, match="Imitation reads 'demonstrator_action'"):
        loss.actor_loss(TestContract().make_data().exclude("demonstrator_action"))
    loss.set_keys(demonstrator_action="advice")
    assert "advice" in loss.in_keys
    loss.actor_loss(TestContract().make_data().rename_key_("demonstrator_action", "advice"))


@pytest.mark.parametrize("told", ["demonstrator_distance", "action_rate"])
@pytest.mark.parametrize("kind", [DDPGLoss, SACLoss, TD3Loss])
def test_it_attaches_to_any_loss_and_to_critics_that_are_not_ours(
    kind: type[TD3Loss | DDPGLoss | SACLoss], told: str
) -> None:
    torch.manual_seed(0)
    network: torch.nn.Module = MLP(in_features=6, out_features=4 if kind is SACLoss else 2, num_cells=[16])
    if kind is SACLoss:  # mean and deviation
        network = torch.nn.Sequential(network, NormalParamExtractor())
    keys = ["observation", "action"], ["state_action_value"]
    critics = [TensorDictModule(MLPCritic(), *keys) for _ in range(kind.num_critics)]
    base = kind.of_networks(kind.policy_of(network, SPEC), critics, SPEC)
    loss = Imitation(base, limit=2.0) if told == "demonstrator_distance" else ActionRate(base, actions=2, limit=2.0)
    data = TestContract().make_data()
    with torch.random.fork_rng():  # SAC draws its action: the same one both times
        plain = loss.base.actor_loss(data)[0]
    value, metadata = loss.actor_loss(data)
    assert metadata[told].shape == data.batch_size
    assert value.isfinite() and value > plain
    value.backward()
    assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in loss.actor_network_params.values(True, True))


def test_fork_goes_around_it() -> None:
    loss = fork(TestContract().make_loss())
    loss.update_gate(0.01)
    value, metadata = loss.actor_loss(TestContract().make_data())
    assert value.isfinite() and {"fork_term", "demonstrator_distance"} <= set(metadata)
