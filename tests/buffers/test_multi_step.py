"""n-step transitions of whole episodes, on numbers worked out by hand."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded, ReplayBuffer

from uavrl.buffers import BackwardReward, FrameStorage, MultiStep, multi_step_returns
from uavrl.losses import TD3Loss
from uavrl.models import Actor, Critic
from uavrl.training.update import ActorCriticStepper

# Two episodes: four steps to a collision, two to a time-out.
REWARD = [1.0, 2.0, 4.0, -8.0, 3.0, 5.0]
DONE = [False, False, False, True, False, True]
TERMINATED = [False, False, False, True, False, False]


def episodes() -> TensorDict:
    states = torch.arange(6.0)[:, None]
    return TensorDict(
        {
            "observation": states,
            "action": torch.zeros(6, 1),
            "next": {
                "observation": states + 100.0,
                "reward": torch.tensor(REWARD)[:, None],
                "done": torch.tensor(DONE)[:, None],
                "terminated": torch.tensor(TERMINATED)[:, None],
                "arrived": torch.tensor(TERMINATED)[:, None],
            },
        },
        [6],
    )


def test_returns_of_two_episodes() -> None:
    """γ = ½, n = 3: 1 + 1 + 1, 2 + 2 - 2, 4 - 4, -8 | 3 + 2.5, 5; single steps are themselves."""
    returns, steps = multi_step_returns(torch.tensor(REWARD), torch.tensor(DONE), 0.5, 3)
    assert returns.tolist() == [3.0, 2.0, 0.0, -8.0, 5.5, 5.0]
    assert steps.tolist() == [3, 3, 2, 1, 2, 1]
    returns, steps = multi_step_returns(torch.tensor(REWARD), torch.tensor(DONE), 0.99, 1)
    assert (returns.tolist(), steps.tolist()) == (REWARD, [1] * 6)


@pytest.mark.parametrize("done", [[], [True, False]])
def test_half_episodes_are_refused(done: list[bool]) -> None:
    with pytest.raises(ValueError, match="whole episodes"):
        multi_step_returns(torch.zeros(len(done)), torch.tensor(done, dtype=torch.bool), 0.9, 2)


def test_states_and_flags_are_those_n_steps_on() -> None:
    given = episodes()
    buffer = ReplayBuffer(storage=FrameStorage(10, frames=1), transform=MultiStep(3, 0.5))
    buffer.extend(given)
    stored = buffer[:]
    assert stored["observation"].flatten().tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert stored["next", "observation"].flatten().tolist() == [102.0, 103.0, 103.0, 103.0, 105.0, 105.0]
    assert stored["next", "terminated"].flatten().tolist() == [False, True, True, True, False, False]
    assert stored["next", "done"].flatten().tolist() == [False, True, True, True, True, True]
    assert (given == episodes()).all(), "the given data is not modified"


def test_the_backward_reward_pays_single_steps_before_they_are_summed() -> None:
    pays = BackwardReward(lambda states: torch.zeros(len(states), dtype=torch.long), frames=1, multiplier=1.0)
    both = ReplayBuffer(storage=FrameStorage(10, frames=1), transform=MultiStep(2, 0.5))
    both.append_transform(pays)  # writes pass from the last to the first
    both.extend(episodes())
    # The first episode "arrives": R = 1, 2, 4, -8, whose places among those before are 0, 1, 2, 0.
    assert both[:]["next", "reward"].flatten().tolist() == [1.0 + 1.5, 3.0 + 3.0, 6.0 - 4.0, -8.0, 5.5, 5.0]


def test_targets_discount_by_the_steps_made_and_bootstrap_at_time_outs_alone() -> None:
    """Target critics that say 1 everywhere: R + γ^k, but where an end lies within the k steps."""
    buffer = ReplayBuffer(storage=FrameStorage(10, frames=1), transform=MultiStep(3, 0.5))
    buffer.extend(episodes())
    batch = buffer[:]
    critics = [TensorDictModule(Critic(1, 1, [2]), ["observation", "action"], ["state_action_value"]) for _ in range(2)]
    actor = TensorDictModule(Actor(1, 1, [2]), ["observation"], ["action"])
    loss = TD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (1,)), gamma=0.5)
    stepper = ActorCriticStepper(loss, execution="captured")
    for key, value in loss.target_qvalue_network_params.items(True, True):
        value.data.fill_(1.0 if key[-2:] == ("2", "bias") else 0.0)
    expected = torch.tensor([3.0 + 0.125, 2.0, 0.0, -8.0, 5.5 + 0.25, 5.0 + 0.5])
    priority = [stepper.critic.gradients(batch[i : i + 1]).metadata["priority"] for i in range(6)]
    with torch.no_grad():
        values = torch.stack([critic.module(batch["observation"], batch["action"])[:, 0] for critic in critics])
    assert torch.allclose(torch.cat(priority), (values - expected).abs().amax(0), atol=1e-5)


@pytest.mark.parametrize(("n_steps", "gamma"), [(0, 0.9), (2, 1.1), (2, -0.1)])
def test_settings_out_of_range_are_refused(n_steps: int, gamma: float) -> None:
    with pytest.raises(ValueError, match="n_steps of at least 1"):
        MultiStep(n_steps, gamma)
