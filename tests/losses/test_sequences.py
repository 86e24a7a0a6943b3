"""Losses of networks with a memory on windows of episodes."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.data import Bounded

from tests.helpers import torchrl_losses
from uavrl.errors import UavrlError
from uavrl.losses import ActionRate, ActorCriticLoss, Imitation, LifeGuard, SACLoss, SequenceLoss, TD3Loss
from uavrl.models import Actor, Critic, GaussianActor, GRUMemory
from uavrl.models.memory import CRITIC_MEMORY, MEMORY
from uavrl.training.cloning import Cloning
from uavrl.training.update import ActorCriticStepper

SPEC = Bounded(-2.0, 2.0, (2,))
WINDOWS, STEPS, BURN_IN, LENGTH, SIZE = 4, 8, 3, 4, 5
BASES: dict[str, type[ActorCriticLoss]] = {"td3": TD3Loss, "sac": SACLoss}


def loss_of(name: str, around: Callable[[ActorCriticLoss], ActorCriticLoss] = lambda base: base) -> SequenceLoss:
    torch.manual_seed(0)
    kind, network = BASES[name], GaussianActor if name == "sac" else Actor
    actor = kind.policy_of(network(SIZE + 6, 2, (8,)), SPEC, in_keys=(MEMORY, "observation"))
    keys = [CRITIC_MEMORY, "observation", "action"]
    critics = [TensorDictModule(Critic(SIZE + 6, 2, (8,)), keys, ["state_action_value"]) for _ in range(2)]
    base = around(kind.of_networks(actor, critics, SPEC))
    return SequenceLoss(base, GRUMemory(6, SIZE), GRUMemory(6, SIZE))


def windows(seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return 2 * torch.rand(*shape, generator=generator, dtype=torch.float32) - 1

    seen, now = uniform(WINDOWS, STEPS, 6), torch.arange(BURN_IN, BURN_IN + LENGTH).expand(WINDOWS, -1)
    rows = torch.arange(WINDOWS)[:, None]
    no = torch.zeros(WINDOWS, LENGTH, 1, dtype=torch.bool)
    after = {"observation": seen[rows, now + 1], "reward": uniform(WINDOWS, LENGTH, 1), "done": no, "terminated": no}
    weight = torch.full((WINDOWS, LENGTH), 1 / LENGTH)
    weight[0] = torch.tensor([0.5, 0.5, 0.0, 0.0])  # cut short by the end of its episode
    steps = {
        "observation": seen[rows, now],
        "action": uniform(WINDOWS, LENGTH, 2),
        "demonstrator_action": uniform(WINDOWS, LENGTH, 2),
        "next": after,
        "now": now,
        "then": now + 1,
        "priority_weight": weight,
    }
    return TensorDict({"seen": seen, "steps": TensorDict(steps, [WINDOWS, LENGTH])}, [WINDOWS])


def test_the_values_are_those_of_the_states_with_what_is_remembered_in_them() -> None:
    """TD3 without target noise, written out for the memories of each step, one after the other."""
    loss = loss_of("td3")
    base = loss.unwrapped
    base.policy_noise.zero_()  # type: ignore[operator]
    with torch.no_grad():
        for parameter in (*loss.target_actor_memory.parameters(), *loss.target_critic_memory.parameters()):  # type: ignore[union-attr]
            parameter.mul_(0.5)
    batch = windows()
    seen, steps = batch["seen"], batch["steps"]
    total = torch.zeros(())
    for row in range(WINDOWS):
        for place in range(LENGTH):
            step = steps[row, place]
            now, then = int(step["now"]), int(step["then"])

            def after(memory: GRUMemory, last: int, row: int = row) -> Tensor:
                return memory.unroll(seen[row : row + 1, : last + 1])[0, -1]

            with torch.no_grad(), base.target_actor_network_params.to_module(base.actor_network):  # type: ignore[union-attr]
                acting = torch.cat([after(loss.target_actor_memory, then), step["next", "observation"]])  # type: ignore[arg-type]
                action = base.actor_network.module(acting)  # type: ignore[union-attr, operator]
            values, targets = [], []
            for number in range(2):
                with base.target_qvalue_network_params[number].to_module(base.qvalue_network):  # type: ignore[union-attr]
                    told = after(loss.target_critic_memory, then), step["next", "observation"], action
                    targets.append(base.qvalue_network.module(*told).detach())  # type: ignore[union-attr, operator]
                with base.qvalue_network_params[number].to_module(base.qvalue_network):  # type: ignore[union-attr]
                    told = after(loss.critic_memory, now), step["observation"], step["action"]
                    values.append(base.qvalue_network.module(*told))  # type: ignore[union-attr, operator]
            target = step["next", "reward"] + 0.99 * torch.minimum(*targets)
            total = total + step["priority_weight"] * sum((value - target).square().sum() for value in values)
    torch.testing.assert_close(loss.value_loss(batch)[0], total / WINDOWS)


def test_the_actor_is_judged_by_the_critic_with_what_the_critic_remembers() -> None:
    """TD3's actor loss, written out step by step."""
    loss, batch = loss_of("td3"), windows()
    base, total = loss.unwrapped, torch.zeros(())
    for row in range(WINDOWS):
        for place in range(LENGTH):
            step = batch["steps"][row, place]
            seen = batch["seen"][row : row + 1, : int(step["now"]) + 1]
            remembered = loss.actor_memory.unroll(seen)[0, -1], loss.critic_memory.unroll(seen)[0, -1]
            with base.actor_network_params.to_module(base.actor_network):  # type: ignore[union-attr]
                action = base.actor_network.module(torch.cat([remembered[0], step["observation"]]))  # type: ignore[union-attr, operator]
            with base.qvalue_network_params[0].to_module(base.qvalue_network):  # type: ignore[union-attr]
                value = base.qvalue_network.module(remembered[1], step["observation"], action)  # type: ignore[union-attr, operator]
            total = total - step["priority_weight"] * value.squeeze()
    torch.testing.assert_close(loss.actor_loss(batch)[0], total / WINDOWS)


def test_a_loss_of_torchrl_is_refused_in_a_sentence() -> None:
    own = loss_of("td3")
    theirs = torchrl_losses.BASES["td3"]()
    with pytest.raises(UavrlError, match=r"takes uavrl's TD3Loss or SACLoss, .* got a torchrl\.TD3Loss"):
        SequenceLoss(theirs, own.actor_memory, own.critic_memory)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", BASES)
def test_both_losses_reach_into_the_first_step_of_a_window_each_by_its_own_memory(name: str) -> None:
    loss, batch = loss_of(name), windows()
    for method, own, other in (
        (loss.value_loss, loss.critic_memory, loss.actor_memory),
        (loss.actor_loss, loss.actor_memory, loss.critic_memory),
    ):
        batch["seen"].requires_grad_().grad = None
        loss.zero_grad()
        method(batch)[0].backward()
        assert batch["seen"].grad[:, 0].abs().max() > 0, "through the burn-in"
        assert all(parameter.grad.abs().max() > 0 for parameter in own.parameters())
        assert all(parameter.grad is None for parameter in other.parameters())
        assert all(parameter.grad is None for parameter in loss.target_critic_memory.parameters())


@pytest.mark.parametrize("name", BASES)
def test_steps_behind_the_end_of_an_episode_count_for_nothing(name: str) -> None:
    loss, batch = loss_of(name), windows()
    changed = batch.clone()
    changed["steps", "next", "reward"][0, 2:] += 100.0
    losses = []
    for each in (batch, changed):
        torch.manual_seed(1)
        losses.append(loss.value_loss(each)[0])
    torch.testing.assert_close(*losses)


@pytest.mark.parametrize("name", BASES)
def test_an_update_moves_networks_memories_and_their_targets(name: str) -> None:
    loss = loss_of(name)
    stepper = ActorCriticStepper(loss, policy_delay=1, tau=0.25, execution="eager")
    before = {key: value.clone() for key, value in loss.state_dict().items() if torch.is_tensor(value)}
    stepper.step(None, windows())
    after = loss.state_dict()
    for memory in ("critic_memory", "actor_memory"):
        if (target := f"target_{memory}") == "target_actor_memory" and name == "sac":
            assert loss.target_actor_memory is None
            continue
        key = "gru.weight_hh_l0"
        assert not torch.equal(after[f"{memory}.{key}"], before[f"{memory}.{key}"])
        wanted = before[f"{target}.{key}"].lerp(after[f"{memory}.{key}"], 0.25)
        torch.testing.assert_close(after[f"{target}.{key}"], wanted)


@pytest.mark.parametrize("name", BASES)
def test_penalties_read_the_state_as_it_is_observed(name: str) -> None:
    """The last two numbers of the observation are the last action, whatever is remembered beside them."""
    batch = windows()

    def around(base: ActorCriticLoss) -> ActorCriticLoss:
        guarded = LifeGuard(base, observations=3, actions=2, min_evaluations=0)
        return ActionRate(Imitation(guarded, limit=2.0), actions=2, limit=2.0, weight=0.5)

    loss = loss_of(name, around)
    torch.manual_seed(1)
    _, metadata = loss.actor_loss(batch)
    torch.manual_seed(1)
    action = loss.act(loss.states(batch))["action"]
    last = 2.0 * batch["steps", "observation"].flatten(0, 1)[:, -2:]
    rate = 0.25 * (action - last).square().mean(-1)
    torch.testing.assert_close(metadata["action_rate"], rate.detach())
    scripted = batch["steps", "demonstrator_action"].flatten(0, 1)
    torch.testing.assert_close(metadata["demonstrator_distance"], 0.25 * (action - scripted).square().mean(-1).detach())


def test_the_temperature_learns_from_no_step_behind_the_end_of_an_episode() -> None:
    loss, batch = loss_of("sac"), windows()
    found = []
    for value in (0.0, 5.0):
        batch["steps", "observation"][0, 2:] = value  # which count for nothing
        torch.manual_seed(1)
        found.append(loss.actor_loss(batch)[1]["log_prob"])
    assert found[0].shape == () and found[0] == found[1]
    batch["steps", "observation"][0, 0] = 5.0
    torch.manual_seed(1)
    assert loss.actor_loss(batch)[1]["log_prob"] != found[0]


def test_the_demonstrator_is_cloned_on_windows() -> None:
    loss, batch = loss_of("td3"), windows()
    cloning = Cloning(loss, limit=2.0, lr=1e-2, execution="eager")
    first = cloning.learn([batch], steps=0)
    last = cloning.learn([batch] * 150, steps=0)
    assert first is not None and last is not None
    assert cloning.learn([batch], steps=cloning.steps) < 0.3 * first  # type: ignore[operator]
    cloning._hand_over()
    for one, other in zip(loss.actor_memory.parameters(), loss.target_actor_memory.parameters(), strict=True):  # type: ignore[union-attr]
        assert torch.equal(one, other)
