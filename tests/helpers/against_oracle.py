"""Whole updates of the library against a plain PyTorch implementation of the same equations."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import Bounded

from tests.helpers import oracle
from tests.helpers.updates import ACTIONS, FRAME, STATE, batch_number, cast, episodes, plain
from uavrl.losses import ActorCriticLoss, DDPGLoss, Fork, LifeGuard, SACLoss, TD3Loss
from uavrl.models import Actor, Critic, GaussianActor, RewardNet, SystemNet
from uavrl.models.collision import LinearClassifier
from uavrl.training.compiled import Execution
from uavrl.training.update import ActorCriticStepper

CELLS = (64, 48)
UPDATES, EPISODES_EVERY = 50, 10  # LifeGuard is evaluated whenever episodes are shown
THRESHOLD = 0.3
MAX_REWARD = 8.0
GUARD = {
    "min_collisions": 4,
    "min_evaluations": 2,
    "min_true_negative_rate": 0.5,
    "batch_size": 20,
    "evaluation_window": 4,
    "model_lr": 1e-2,
}
ACTIVE = [False, False, True, True, True]  # one evaluation whenever episodes are shown, more than two are needed


# ---------------------------------------------------------------------- both sides, with the same weights


@dataclass
class Case:
    """One learner: what it is made of, and how large its networks are."""

    algo: str = "td3"
    fork: float | None = None  # the threshold of its gate
    guard: str | None = None  # its classifier
    cells: Sequence[int] = CELLS
    low: tuple[float, ...] = (-2.0, -2.0)
    high: tuple[float, ...] = (2.0, 2.0)


CASES = {
    "td3": Case(),
    "td3_wide": Case(cells=(400, 300)),
    "td3_uneven_ranges": Case(low=(-3.0, -0.5), high=(1.0, 0.5)),
    "ddpg": Case("ddpg"),
    "td3_fork_open": Case(fork=1e9),
    "td3_fork_switching": Case(fork=THRESHOLD),
    "td3_lg_linear": Case(guard="linear"),
    "td3_lg_mlp": Case(guard="mlp"),
    "ddpg_fork_lg": Case("ddpg", fork=THRESHOLD, guard="mlp"),
}


def library(case: Case) -> ActorCriticLoss:
    """The library's loss, with weights drawn from a fixed seed."""
    torch.manual_seed(0)
    low, high = torch.tensor(case.low), torch.tensor(case.high)
    spec = Bounded(low, high)
    keys = ["observation", "action"], ["state_action_value"]
    critics = [TensorDictModule(Critic(STATE, ACTIONS, case.cells), *keys) for _ in "12"]
    actor = (GaussianActor if case.algo == "sac" else Actor)(STATE, ACTIONS, case.cells)
    if case.low != (-2.0, -2.0):
        actor = oracle.Actor(STATE, case.cells, low, high)
    kind = {"td3": TD3Loss, "ddpg": DDPGLoss, "sac": SACLoss}[case.algo]
    loss: ActorCriticLoss = kind.of_networks(kind.policy_of(actor, spec), critics, spec)
    if case.fork is not None:
        loss = Fork(
            loss,
            system_network=SystemNet(STATE, ACTIONS, case.cells),
            reward_network=RewardNet(STATE, ACTIONS, case.cells),
            observations=STATE,
            max_reward=MAX_REWARD,
            threshold=case.fork,
        )
    if case.guard is not None:
        loss = LifeGuard(loss, observations=FRAME, actions=ACTIONS, model=case.guard, **GUARD)
    return loss.double() if torch.get_default_dtype() == torch.float64 else loss  # some buffers do not ask the default


def penalty(loss: ActorCriticLoss, kind: type) -> LifeGuard | Fork | None:
    return next((one for one in loss.penalties if isinstance(one, kind)), None)


def leaves(params: TensorDictBase, index: int | None = None, *, grad: bool = False) -> list[Tensor]:
    """Weights and biases layer by layer, or their gradients; `index` picks one of several stacked networks."""
    found = {tuple(map(str, key[-2:])): value for key, value in params.items(True, True)}
    layers = sorted({int(layer) for layer, _ in found})
    values = [found[str(layer), name] for layer in layers for name in ("weight", "bias")]
    values = [value.grad if grad else value.detach() for value in values]
    return values if index is None else [value[index] for value in values]


def networks(loss: ActorCriticLoss, learner: oracle.DDPG) -> dict[str, tuple[TensorDictBase, int | None, nn.Module]]:
    """Each network: its parameters in the library, its index if it is stacked there, and the oracle's module."""
    base, fork = loss.unwrapped, penalty(loss, Fork)
    found = {
        "actor": (base.actor_network_params, None, learner.actor),
        "target actor": (base.target_actor_network_params, None, learner.target_actor),
    }
    targets = getattr(base, f"target_{base.critic_name}_params")
    for index, (critic, target) in enumerate(zip(learner.critics, learner.target_critics, strict=True)):
        at = index if len(learner.critics) > 1 else None
        found[f"critic{index}"] = (base.critic_network_params, at, critic)
        found[f"target critic{index}"] = (targets, at, target)
    if fork is not None:
        found["system"] = (fork.system_network_params, None, learner.penalties[0].system)
        found["reward"] = (fork.reward_network_params, None, learner.penalties[0].reward)
    return found


def copy_into(module: nn.Module, values: Sequence[Tensor]) -> None:
    with torch.no_grad():
        for parameter, value in zip(module.parameters(), values, strict=True):
            parameter.copy_(value)


def by_hand(case: Case, loss: ActorCriticLoss) -> oracle.DDPG:
    """The oracle with the library's weights."""
    low, high = torch.tensor(case.low), torch.tensor(case.high)
    actor = oracle.Actor(STATE, case.cells, low, high)
    critics = [oracle.OfPair(STATE + ACTIONS, case.cells, 1) for _ in range(1 if case.algo == "ddpg" else 2)]
    penalties: list[oracle.ActorLoss] = []
    if case.fork is not None:
        system = oracle.OfPair(STATE + ACTIONS, case.cells, STATE)
        reward = oracle.OfPair(2 * STATE + ACTIONS, case.cells, 1)
        penalties.append(oracle.Fork(system, reward, lr=3e-4, threshold=case.fork, max_reward=MAX_REWARD))
    if case.guard is not None:
        penalties.append(oracle.LifeGuard(lambda x: x[..., 0], last=FRAME))
    learner = {"td3": oracle.TD3, "ddpg": oracle.DDPG}[case.algo](actor, critics, low, high, penalties)
    for params, index, module in networks(loss, learner).values():
        copy_into(module, leaves(params, index))
    return learner


def classifier_of(guard: LifeGuard) -> Callable[[Tensor], Tensor]:
    """A copy of LifeGuard's classifier as it is now, in plain PyTorch."""
    model = guard.classifier.model
    if isinstance(model, LinearClassifier):
        weight, intercept = model.weight.clone(), model.intercept.clone()
        return lambda x: torch.mv(x, weight.to(x.dtype)) + intercept.to(x.dtype)
    values = [value.detach().clone() for value in model.parameters()]
    network = oracle.relu_network([FRAME + ACTIONS, *(len(bias) for bias in values[1::2])])
    copy_into(network, values)
    return lambda x: network(x).squeeze(-1)


def show(stepper: ActorCriticStepper, learner: oracle.DDPG, data: TensorDict) -> None:
    """Shows new episodes to both."""
    stepper.observe(data, lambda n: data[torch.randint(len(data), (n,))])
    done = data["next", "done"].squeeze(-1)
    lengths = torch.diff(done.nonzero().squeeze(-1), prepend=torch.tensor([-1])).tolist()
    for one in learner.penalties:
        if isinstance(one, oracle.Fork):
            one.observe(torch.cat([data["observation"], data["next", "observation"]]))
            one.returns.extend(float(rewards.sum()) for rewards in data["next", "reward"].split(lengths))
        if isinstance(one, oracle.LifeGuard):
            guard = penalty(stepper.loss, LifeGuard)
            assert isinstance(guard, LifeGuard)
            arrived = data["next", "arrived"].squeeze(-1)[done]
            one.observe(data["observation"], data["action"], arrived.tolist())
            one.logit, one.active = classifier_of(guard), guard.active


# ---------------------------------------------------------------------- the comparison


def compare_update(result: TensorDictBase, loss: ActorCriticLoss, learner: oracle.DDPG, tolerance: float) -> None:
    """Losses and gradients of the update that both have just made."""
    ours = {"critic": float(result["loss_value"]), "actor": float(result["loss_actor"])}
    if (fork := penalty(loss, Fork)) is not None:
        said = fork.diagnostics()
        ours |= {"system": said["system_loss"], "reward": said["reward_loss"]}
    for name, expected in learner.losses.items():
        assert ours[name] == pytest.approx(expected, rel=tolerance, abs=tolerance), name
    both = networks(loss, learner)
    for name, gradients in learner.gradients.items():
        params, index, _ = both[name]
        scale = max(gradient.abs().max().item() for gradient in gradients)
        assert scale > 0, name
        found = leaves(params, index, grad=True)
        torch.testing.assert_close(found, gradients, atol=tolerance * max(scale, 1), rtol=10 * tolerance)


def compare_parameters(loss: ActorCriticLoss, learner: oracle.DDPG, tolerance: float) -> None:
    """Online and target networks, and FORK's models."""
    for params, index, module in networks(loss, learner).values():
        expected = [p.detach() for p in module.parameters()]
        torch.testing.assert_close(leaves(params, index), expected, atol=tolerance, rtol=0.0)


def compare_updates(name: str, execution: Execution, dtype: torch.dtype) -> None:
    """Makes the same updates on both sides, in a precision, and asserts that losses, gradients and networks agree."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        _compare_updates(CASES[name], execution, {torch.float32: 1e-5, torch.float64: 1e-10}[dtype])
    finally:
        torch.set_default_dtype(before)


def _compare_updates(case: Case, execution: Execution, tolerance: float) -> None:
    loss = library(case)
    learner = by_hand(case, loss)
    stepper = ActorCriticStepper(loss, policy_delay=learner.delay, execution=execution)
    compare_parameters(loss, learner, 0.0)
    active: list[bool] = []
    for update in range(UPDATES):
        if update % EPISODES_EVERY == 0:
            show(stepper, learner, cast(episodes(update)))
            active += [one.active for one in learner.penalties if isinstance(one, oracle.LifeGuard)]
        data = cast(batch_number(update))
        batch = plain(data)
        torch.manual_seed(update)
        result = stepper.step(None, data)
        torch.manual_seed(update)
        learner.update(batch)
        compare_update(result, loss, learner, tolerance)
    compare_parameters(loss, learner, tolerance)
    assert active == (ACTIVE if case.guard else [])
    if case.fork == THRESHOLD:
        opened = learner.penalties[0].opened[learner.delay - 1 :: learner.delay]  # as the actor's updates saw the gate
        assert 5 < sum(opened) < len(opened) - 5
        assert sum(one != two for one, two in itertools.pairwise(opened)) > 5


# ---------------------------------------------------------------------- recorded updates


RECORDED = {
    "td3": Case(),
    "ddpg": Case("ddpg"),
    "sac": Case("sac"),
    "td3_fork": Case(fork=THRESHOLD),
    "td3_lg": Case(guard="linear"),
    "td3_lg_mlp": Case(guard="mlp"),
}


def trained(case: Case, execution: Execution, updates: int = 30) -> dict[str, Tensor]:
    """Everything in the loss after some updates, drawn from one stream of random numbers."""
    loss = library(case)
    stepper = ActorCriticStepper(loss, policy_delay=1 if case.algo == "ddpg" else 2, execution=execution)
    torch.manual_seed(5)
    results: dict[str, Tensor] = {}
    for update in range(updates):
        if update % EPISODES_EVERY == 0:
            data = episodes(update)
            stepper.observe(data, lambda n, data=data: data[torch.randint(len(data), (n,))])
        batch = batch_number(update)
        said = stepper.step(None, batch)
        results |= {f"{key}_{update}": value for key, value in said.items()} | {f"error_{update}": batch["td_error"]}
    results["random"] = torch.rand(8)
    return results | {
        name: value.detach().clone() for name, value in loss.state_dict().items() if isinstance(value, Tensor)
    }
