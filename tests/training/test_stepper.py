from __future__ import annotations

import copy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded

from uavrl.losses import DDPGLoss, TD3Loss
from uavrl.models import Actor, Critic
from uavrl.training.stepper import ActorCriticStepper


def make_loss(name: str) -> TD3Loss | DDPGLoss:
    torch.manual_seed(0)
    actor = TensorDictModule(Actor(6, 2, (16,)), ["observation"], ["action"])
    critics = [TensorDictModule(Critic(6, 2, (16,)), ["observation", "action"], ["state_action_value"]) for _ in "12"]
    if name == "td3":
        return TD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (2,)), policy_noise=0.0)
    return DDPGLoss(actor, critics[0])


def batch() -> TensorDict:
    torch.manual_seed(1)
    data = {"observation": torch.randn(10, 6), "action": torch.rand(10, 2)}
    ends = torch.arange(10)[:, None] % 4 == 3
    following = {"observation": torch.randn(10, 6), "reward": torch.randn(10, 1), "done": ends, "terminated": ends}
    return TensorDict({**data, "next": following}, [10])


def parameters(loss: torch.nn.Module) -> dict[str, torch.Tensor]:
    return {key: value.detach().cpu().clone() for key, value in loss.state_dict().items() if value is not None}


def moved(before: dict[str, torch.Tensor], after: dict[str, torch.Tensor], part: str) -> bool:
    keys = [key for key in before if key.startswith(part) and before[key].ndim > 1]
    assert keys, part
    return any(not torch.equal(before[key], after[key]) for key in keys)


def test_actor_and_targets_follow_the_policy_delay() -> None:
    loss = make_loss("td3")
    stepper = ActorCriticStepper(loss, policy_delay=2)
    start = parameters(loss)
    stepper.step(None, batch())
    first = parameters(loss)
    assert moved(start, first, "qvalue_network_params")
    assert not moved(start, first, "actor_network_params")
    assert not moved(start, first, "target_qvalue_network_params")
    assert not moved(start, first, "target_actor_network_params")
    stepper.step(None, batch())
    second = parameters(loss)
    assert moved(first, second, "actor_network_params")
    assert moved(first, second, "target_qvalue_network_params")
    assert moved(first, second, "target_actor_network_params")


def test_targets_move_by_tau() -> None:
    loss = make_loss("td3")
    stepper = ActorCriticStepper(loss, policy_delay=1, tau=0.25)
    before = parameters(loss)
    stepper.step(None, batch())
    after = parameters(loss)
    for key in before:
        if key.startswith("target_"):
            expected = 0.75 * before[key] + 0.25 * after[key.removeprefix("target_")]
            torch.testing.assert_close(after[key], expected)


@pytest.mark.parametrize("name", ["td3", "ddpg"])
def test_the_priority_is_the_largest_absolute_td_error(name: str) -> None:
    data, loss = batch(), make_loss(name)
    _, metadata = loss.value_loss(data.clone())
    error = (metadata["pred_value"] - metadata["target_value"]).detach().abs()
    ActorCriticStepper(loss).step(None, data)
    torch.testing.assert_close(data["td_error"], error.amax(0) if error.ndim > 1 else error)


@pytest.mark.parametrize("name", ["td3", "ddpg"])
def test_a_restored_stepper_goes_on_the_same(name: str) -> None:
    loss = make_loss(name)
    stepper = ActorCriticStepper(loss)
    for _ in range(3):
        stepper.step(None, batch())
    other_loss = make_loss(name)
    other = ActorCriticStepper(other_loss)
    other_loss.load_state_dict(copy.deepcopy(loss.state_dict()))
    other.load_state_dict(copy.deepcopy(stepper.state_dict()))
    for _ in range(3):
        stepper.step(None, batch())
        other.step(None, batch())
    one, two = parameters(loss), parameters(other_loss)
    assert all(torch.equal(one[key], two[key]) for key in one)


@pytest.mark.gpu
@pytest.mark.parametrize("name", ["td3", "ddpg"])
def test_cuda_gives_what_the_cpu_gives(name: str) -> None:
    results = []
    for device in ("cpu", "cuda"):
        loss = make_loss(name).to(device)
        stepper = ActorCriticStepper(loss)
        for _ in range(20):
            stepper.step(None, batch().to(device))
        results.append(parameters(loss))
    for key in results[0]:
        torch.testing.assert_close(results[0][key], results[1][key], rtol=1e-3, atol=1e-4)
