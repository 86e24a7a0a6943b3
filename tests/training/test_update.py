from __future__ import annotations

import copy
import itertools

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.data import Bounded

from tests.helpers.any_network import CRITICS, compare_updates
from tests.helpers.losses import critics, episodes, fork, lifeguard, sampler, stochastic_actor
from uavrl.buffers import PrioritizedBuffer
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss, DDPGLoss, LifeGuard, SACLoss, TD3Loss
from uavrl.models import Actor, Critic
from uavrl.training.compiled import Execution, LossGradients
from uavrl.training.update import ActorCriticStepper


def make_loss(name: str) -> TD3Loss | DDPGLoss:
    torch.manual_seed(0)
    actor = TensorDictModule(Actor(6, 2, (16,)), ["observation"], ["action"])
    critics = [TensorDictModule(Critic(6, 2, (16,)), ["observation", "action"], ["state_action_value"]) for _ in "12"]
    if name == "td3":
        return TD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (2,)), policy_noise=0.0)
    return DDPGLoss(actor, critics[0])


def make_penalized(threshold: float = 1e9) -> LifeGuard:
    """TD3 with FORK and, around both, LifeGuard with a network for a classifier."""
    return lifeguard(fork(make_loss("td3"), threshold=threshold), model="mlp", model_lr=1e-2)


def make_any(name: str) -> ActorCriticLoss:
    torch.manual_seed(0)
    if name == "sac":
        return SACLoss(stochastic_actor(), critics(), action_spec=Bounded(-2.0, 2.0, (2,)))
    return make_penalized() if name == "td3_fork_lg" else make_loss(name)


def flown() -> TensorDict:
    data = episodes(10)
    following = torch.cat([data["observation"][1:], data["observation"][:1]])
    data["next"].update({"observation": following, "reward": torch.ones(len(data), 1)})
    return data


def batch() -> TensorDict:
    torch.manual_seed(1)
    data = {"observation": torch.randn(10, 6), "action": torch.rand(10, 2)}
    ends = torch.arange(10)[:, None] % 4 == 3
    following = {"observation": torch.randn(10, 6), "reward": torch.randn(10, 1), "done": ends, "terminated": ends}
    return TensorDict({**data, "next": following}, [10])


def parameters(loss: torch.nn.Module) -> dict[str, torch.Tensor]:
    return {key: value.detach().cpu().clone() for key, value in loss.state_dict().items() if isinstance(value, Tensor)}


def moved(before: dict[str, torch.Tensor], after: dict[str, torch.Tensor], part: str) -> bool:
    keys = [key for key in before if key.startswith(part) and before[key].ndim > 1]
    assert keys, part
    return any(not torch.equal(before[key], after[key]) for key in keys)


@pytest.mark.parametrize("name", ["td3", "ddpg"])
def test_the_priority_is_the_largest_absolute_td_error(name: str) -> None:
    data, loss = batch(), make_loss(name)
    _, metadata = loss.value_loss(data.clone())
    error = (metadata["pred_value"] - metadata["target_value"]).detach().abs()
    ActorCriticStepper(loss).step(None, data)
    torch.testing.assert_close(data["td_error"], error.amax(0) if error.ndim > 1 else error)


def test_a_renamed_priority_is_written_under_its_name() -> None:
    data, loss = batch(), make_loss("td3")
    loss.set_keys(priority="urgency")
    ActorCriticStepper(loss).step(None, data)
    assert data["urgency"].shape == (10,)
    assert "td_error" not in data.keys()  # noqa: SIM118


def go_on(stepper: ActorCriticStepper, seed: int) -> list[TensorDictBase]:
    """Four times new episodes and two updates."""
    torch.manual_seed(seed)
    results: list[TensorDictBase] = []
    for _ in range(4):
        data = flown()
        stepper.observe(data, sampler(data))
        for _ in range(2):
            results.append(stepper.step(None, batch()))
    return results


OPTIMISERS = {
    "td3": {"actor_optimizer", "critic_optimizer"},
    "ddpg": {"actor_optimizer", "critic_optimizer"},
    "sac": {"actor_optimizer", "critic_optimizer", "temperature_optimizer"},
    "td3_fork_lg": {"actor_optimizer", "critic_optimizer", "model_optimizer_0", "fit_optimizer_0"},
}


@pytest.mark.parametrize("name", list(OPTIMISERS))
def test_a_restored_stepper_goes_on_the_same(name: str) -> None:
    loss = make_any(name)
    stepper = ActorCriticStepper(loss, policy_delay=5)
    start = parameters(loss)
    go_on(stepper, 1)
    state = copy.deepcopy(stepper.state_dict())
    assert {key for key in state if "optimizer" in key} == OPTIMISERS[name]
    assert all(state[key]["state"] for key in OPTIMISERS[name])  # each has made a step
    if name == "td3_fork_lg":
        assert [penalty.active for penalty in loss.penalties] == [True, True]
    other_loss = make_any(name)
    other = ActorCriticStepper(other_loss, policy_delay=5)
    other_loss.load_state_dict(copy.deepcopy(loss.state_dict()))
    other.load_state_dict(state)
    middle = parameters(loss)
    said, repeated = go_on(stepper, 2), go_on(other, 2)
    assert all((one == two).all() for one, two in zip(said, repeated, strict=True))
    one, two = parameters(loss), parameters(other_loss)
    assert [key for key in one if not torch.equal(one[key], two[key])] == []
    trained = [key for key, value in loss.named_parameters() if "target" not in key and value.ndim > 1]
    assert all(
        moved(before, after, key) for key in trained for before, after in itertools.pairwise((start, middle, one))
    )


def test_the_actors_loss_is_recorded_once_for_each_set_of_terms() -> None:
    """The gate of FORK and the trust in LifeGuard change the loss; a recording of another mode would be wrong."""
    torch.manual_seed(0)
    loss = make_penalized()
    data, others = flown(), flown()[:10]
    for _ in range(4):
        loss.observe(data)
        loss.fit(sampler(data), 20, loss.make_optimizer())
    stepper = ActorCriticStepper(loss, execution="captured")
    recordings: list[object] = []

    def counted(tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        recordings.append((loss.base.active, loss.active))
        return loss.actor_loss(tensordict)

    stepper.actor.gradients.loss_method = counted
    eager = LossGradients(loss.actor_loss, stepper.actor.gradients.parameters, "eager")
    modes = [(gate, heard) for gate in (False, True) for heard in (False, True)]
    for gate, heard in modes + modes[::-1]:
        loss.base.update_gate(0.0 if gate else 1e10)
        loss.min_true_negative_rate = -1.0 if heard else 1.0
        loss.evaluate(others)
        assert (loss.base.active, loss.active) == (gate, heard)
        expected, said = eager(batch()), stepper.actor(batch())
        assert torch.equal(said.loss, expected.loss)
        assert all(map(torch.equal, said.gradients, expected.gradients))
        assert ("fork_term" in said.metadata, "lifeguard_penalty" in said.metadata) == (gate, heard)
    assert recordings == modes


@pytest.mark.parametrize("execution", ["eager", "captured"])
@pytest.mark.parametrize("name", ["td3", "ddpg"])
def test_importance_weights_of_a_prioritised_buffer_count(name: str, execution: Execution) -> None:
    """Σ w e / Σ w, with e the squared errors of each transition; also after batches without weights."""
    np.random.seed(0)  # noqa: NPY002  (TorchRL's prioritised sampler draws from it)
    loss = make_loss(name)
    stepper = ActorCriticStepper(loss, execution=execution, policy_delay=1)
    stepper.step(None, batch())
    buffer = PrioritizedBuffer(32)
    buffer.extend(batch())
    drawn = buffer.sample(10)
    drawn["td_error"] = torch.linspace(0.1, 9.0, 10)
    buffer.update_tensordict_priority(drawn)
    drawn = buffer.sample(10)
    weights = drawn["priority_weight"]
    assert weights.unique().numel() > 2
    _, metadata = loss.value_loss(drawn.exclude("priority_weight"))
    errors = (metadata["pred_value"] - metadata["target_value"]).detach().square().reshape(-1, 10).sum(0)
    said = stepper.step(None, drawn)
    torch.testing.assert_close(said["loss_value"], (weights * errors).sum() / weights.sum())
    assert abs(said["loss_value"] - errors.mean()) > 1e-3


@pytest.mark.parametrize("make", CRITICS)
@pytest.mark.parametrize("algo", ["td3", "sac"])
def test_captured_updates_of_networks_from_elsewhere_are_those_of_plain_pytorch(
    algo: str, make: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    compare_updates(algo, make, "captured", torch.float64, monkeypatch)


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


def test_the_actors_learning_rate_falls_between_two_numbers_of_updates() -> None:
    """Half way it is half; it never falls below 2 %; a resumed stepper goes on where the other stood."""
    stepper = ActorCriticStepper(make_loss("ddpg"), actor_lr=1e-3, actor_lr_decay=(2, 6), policy_delay=1)
    rates = []
    for _ in range(8):
        stepper.step(None, batch())
        rates.append(stepper.actor.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-3, 1e-3, 7.5e-4, 5e-4, 2.5e-4, 2e-5, 2e-5, 2e-5])
    assert stepper.critic.optimizer.param_groups[0]["lr"] == 1e-3
    resumed = ActorCriticStepper(make_loss("ddpg"), actor_lr=1e-3, actor_lr_decay=(2, 6), policy_delay=1)
    resumed.load_state_dict({**copy.deepcopy(stepper.state_dict()), "updates": 3})
    resumed.step(None, batch())
    assert resumed.actor.optimizer.param_groups[0]["lr"] == pytest.approx(5e-4)


def test_shares_of_a_run_are_no_numbers_of_updates() -> None:
    with pytest.raises(UavrlError, match=r"two numbers of updates here, got the shares \[0\.5, 1\.0\]"):
        ActorCriticStepper(make_loss("ddpg"), actor_lr_decay=(0.5, 1.0))


def test_critics_that_warm_up_take_their_targets_and_memories_along() -> None:
    loss = make_loss("td3")
    stepper, moved = ActorCriticStepper(loss), []
    loss.move_memories = moved.append  # type: ignore[method-assign, assignment]
    before = {key: value.clone() for key, value in parameters(loss).items()}
    stepper.warm_up(batch())
    after = parameters(loss)
    changed = {key.split(".")[0] for key, value in before.items() if not torch.equal(value, after[key])}
    assert changed == {"qvalue_network_params", "target_qvalue_network_params"}
    assert (moved, stepper.updates) == ([stepper.tau], 0)


def test_a_smaller_learning_rate_is_a_smaller_step() -> None:
    """Adam's first step is as long as its learning rate: at 2 % of it every weight that moves, moves by 2 %."""
    moves = []
    for decay in (None, (0, 1.5)):
        loss = make_loss("ddpg")
        before = parameters(loss)
        stepper = ActorCriticStepper(loss, actor_lr=1e-2, actor_lr_decay=decay, policy_delay=1)
        stepper.updates = 0 if decay is None else 1
        stepper.step(None, batch())
        moves.append({key: parameters(loss)[key] - value for key, value in before.items() if key.startswith("actor")})
    for key, whole in moves[0].items():
        torch.testing.assert_close(moves[1][key], 0.02 * whole, rtol=2e-3, atol=2e-6)
