from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import ClassVar

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import (
    SPEC,
    Scale,
    ddpg,
    episodes,
    fork,
    lifeguard,
    sac,
    sampler,
    small_td3,
    states,
    td3,
    trained,
)  # fmt: skip
from uavrl.losses import ActorCriticLoss, ActorPenalty, DDPGLoss, Fork, TD3Loss
from uavrl.models import Actor, Critic, SystemNet


class Push(ActorPenalty):
    """An actor penalty without models: a cost on large actions."""

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        return acted["action"].square().sum(-1), {"push": acted["action"].detach()}


class ForkContract(ActorCriticLossContract):
    methods: ClassVar[dict[str, str]] = {
        "value_loss": "critic",
        "actor_loss": "actor",
        "system_loss": "model",
        "reward_loss": "model",
        "model_loss": "model",
    }

    def make_loss(self, **kwargs: object) -> torch.nn.Module:
        loss = self.penalize(**kwargs)
        (gated,) = (one for one in loss.penalties if isinstance(one, Fork))
        gated.update_gate(0.0)
        return loss

    def penalize(self, **kwargs: object) -> ActorPenalty:
        raise NotImplementedError


class TestForkOnTD3(ForkContract):
    compiled: ClassVar[tuple[str, ...]] = ("actor_loss", "model_loss")

    def penalize(self, **kwargs: object) -> Fork:
        return fork(td3(**kwargs))


class TestForkOnSAC(ForkContract):
    def penalize(self, **kwargs: object) -> Fork:
        return fork(sac(**kwargs))


def test_new_models_are_not_used_before_they_are_evaluated() -> None:
    """What was observed of the world stays."""
    loss = TestLifeGuardOnFork().make_loss()
    assert loss.active and loss.base.active
    seen, highest = len(loss.collisions), loss.base.observed_high.clone()
    loss.reset_parameters_recursive()
    assert not loss.active and not loss.base.active
    assert not loss.classifier.model.weight.any()
    assert len(loss.collisions) == seen > 0
    assert torch.equal(loss.base.observed_high, highest)


class _WithLifeGuard(ForkContract):
    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        data = super().make_data(dtype, size)
        data["next", "collided"] = data["next", "terminated"].clone()
        return data


class TestForkOnLifeGuard(_WithLifeGuard):
    def penalize(self, **kwargs: object) -> Fork:
        return fork(trained(lifeguard(td3(**kwargs))))


class TestLifeGuardOnFork(_WithLifeGuard):
    methods: ClassVar[dict[str, str]] = {"value_loss": "critic", "actor_loss": "actor"}

    def penalize(self, **kwargs: object) -> ActorPenalty:
        loss = lifeguard(fork(sac(**kwargs)))
        data = episodes(10)
        data["next"].update({"observation": data["observation"], "reward": torch.ones(len(data), 1)})
        optimizer = loss.make_optimizer()
        for _ in range(8):
            loss.observe(data)
            loss.fit(sampler(data), 20, optimizer)
        assert loss.active
        return loss


# ---------------------------------------------------------------------- by hand


def small(**kwargs: object) -> Fork:
    """On ``small_td3``: f(s, a) = s + a, g(s, s', a) = s - s' + 10 a."""
    options = {"system_network": Scale(1.0, 1.0), "reward_network": Scale(1.0, -1.0, 10.0), "observations": 1}
    return Fork(small_td3(), **(options | {"gamma": 0.5, "base_weight": 0.5, "max_reward": 10.0} | kwargs))


def episode(rewards: list[float], observations: Tensor | None = None, width: int = 1) -> TensorDict:
    length = len(rewards)
    done = torch.arange(length)[:, None] == length - 1
    state = torch.zeros(length + 1, width) if observations is None else observations
    following = {"observation": state[1:], "reward": torch.tensor(rewards)[:, None], "done": done}
    return TensorDict({"observation": state[:-1], "next": following}, [length])


def test_actor_loss_by_hand() -> None:
    """s = 1: μ = 2, s1 = 3, μ1 = 6, s2 = 9, μ2 = 18.

    g = 1 - 3 + 20 = 18, g1 = 3 - 9 + 60 = 54, Q(s2) = 9 + 54 = 63 and Q(s) = 7:
    -7 - 0.5 (18 + 0.5 · 54 + 0.25 · 63) = -37.375.
    """
    loss = small()
    loss.update_gate(0.0)
    value, metadata = loss.actor_loss(states(1.0))
    assert value.item() == pytest.approx(-37.375)
    assert metadata["fork_term"].item() == pytest.approx(-30.375)
    assert metadata["state_action_value_actor"].item() == 7.0


def test_gradient_through_the_model_by_hand() -> None:
    """s = 1, s1 = 1 + θ, s2 = (1 + θ)²; at θ = 2:

    g = 1 - s1 + 10 θ has the slope 9; g1 = s1 - s2 + 10 θ s1 has 1 - 6 + 10 · 3 + 20 = 45;
    Q2 = (1 + 3 θ) s2 has 3 · 9 + 7 · 6 = 69: -3 - 0.5 (9 + 22.5 + 17.25) = -27.375.
    """
    loss = small(backprop_through_model=True)
    loss.update_gate(0.0)
    loss.actor_loss(states(1.0))[0].backward()
    assert loss.actor_network_params["module", "factors"].grad.item() == pytest.approx(-27.375)
    assert loss.system_network_params["module", "factors"].grad is None


@pytest.mark.parametrize("make", [td3, ddpg, sac])
def test_closed_gate_leaves_the_bases_loss(make: Callable[[], ActorCriticLoss]) -> None:
    contract, base = TestForkOnTD3(), make()
    assert torch.equal(contract.evaluate(base, "actor_loss"), contract.evaluate(fork(base), "actor_loss"))


def test_range_grows_and_can_be_switched_off() -> None:
    loss, free = small(), small(clamp=False)
    for one in (loss, free):
        one.observe(episode([0.0], torch.tensor([[-1.0], [2.0]])))
        one.observe(episode([0.0], torch.tensor([[1.0], [3.0]])))
    assert (loss.observed_low.item(), loss.observed_high.item()) == (-1.0, 3.0)
    assert (free.observed_low.item(), free.observed_high.item()) == (-math.inf, math.inf)


# ---------------------------------------------------------------------- weight and gate


def test_weight_follows_the_mean_of_the_last_returns() -> None:
    loss = small(return_window=2)
    weight = loss.weight
    seen = [weight.item()]
    for total in (4.0, -4.0, 8.0, 12.0, 30.0):
        loss.observe(episode([total / 2, total / 2]))
        seen.append(loss.weight.item())
    assert loss.weight is weight
    assert seen == pytest.approx([0.5, 0.3, 0.5, 0.4, 0.0, 0.0])  # means 4, 0, 2, 10, 21 of 10


def test_returns_are_those_that_reward_sum_counted_before_rewards_were_scaled() -> None:
    data = torch.cat([episode([5.0, 10.0]), episode([15.0, -5.0])])
    data["next", "episode_reward"] = torch.tensor([1.0, 3.0, 3.0, -97.0])[:, None]
    loss = small()
    loss.observe(data)
    assert list(loss.returns) == [3.0, -97.0]


@pytest.mark.parametrize("compiled", [False, True])
def test_gate_opens_below_the_threshold_only(compiled: bool) -> None:
    """Within a compiled graph, too."""
    loss = small(threshold=0.1)
    assert not loss.active
    update = torch.compile(loss.update_gate, backend="eager", fullgraph=True) if compiled else loss.update_gate
    gates: list[bool] = []
    for system_loss in (0.05, 0.1, 0.099, float("nan")):
        update(torch.tensor(system_loss), torch.tensor(2.0))
        gates.append(loss.active)
    assert gates == [True, False, True, False]
    update(torch.tensor(0.0625), torch.tensor(2.0))
    assert loss.get_extra_state().tolist() == [1.0, 0.0625, 2.0, 3.0, 5.0]
    assert loss.diagnostics() == {"fork_weight": 0.5, "fork_gate": 0.6, "system_loss": 0.0625, "reward_loss": 2.0}
    loss.update_gate(0.5)
    assert loss.diagnostics()["fork_gate"] == 0.0, "counted since the last call"


def test_forward_updates_the_gate_before_the_actor() -> None:
    loss = fork(td3(), threshold=1e9)
    data = TestForkOnTD3().make_data()
    losses = loss(data)
    assert loss.active
    torch.testing.assert_close(losses["loss_actor"], loss.actor_loss(data)[0])
    torch.testing.assert_close(losses["loss_system"], loss.system_loss(data)[0])
    torch.testing.assert_close(losses["loss_reward"], loss.reward_loss(data)[0])


def test_state_dict_restores_gate_weight_returns_and_range() -> None:
    loss, other = small(), small()
    loss.observe(episode([1.0, 2.0], torch.tensor([[-1.0], [4.0], [0.0]])))
    loss.update_gate(0.001, 0.5)
    other.load_state_dict(copy.deepcopy(loss.state_dict()))
    assert other.active
    assert other.weight == loss.weight
    assert list(other.returns) == [3.0]
    assert (other.observed_low.item(), other.observed_high.item()) == (-1.0, 4.0)
    assert torch.equal(other.actor_loss(states(1.0))[0], loss.actor_loss(states(1.0))[0])
    assert other.diagnostics() == loss.diagnostics()
    for one in (loss, other):
        one.observe(episode([5.0]))
    assert other.weight == loss.weight


def test_penalties_nest_either_way() -> None:
    data = TestForkOnTD3().make_data()
    base = td3()
    inner = fork(Push(base))
    torch.manual_seed(0)
    outer = Push(fork(base, system_network=SystemNet(6, 2, (8,))))
    nested = outer.base
    nested.system_network_params.update_(inner.system_network_params.data)
    nested.reward_network_params.update_(inner.reward_network_params.data)
    inner.update_gate(0.0)
    nested.update_gate(0.0)
    inner.set_vmap_randomness("different")
    assert base.vmap_randomness == "different"
    torch.testing.assert_close(inner.actor_loss(data)[0], outer.actor_loss(data)[0])
    assert inner.active and nested.active
    assert outer.penalties == [outer, nested]
    assert outer.unwrapped is base
    outer.observe(episode([1.0], width=6))
    assert list(nested.returns) == [1.0]
    assert outer.diagnostics().keys() == inner.diagnostics().keys()
    assert {"loss_system", "loss_reward"} <= set(outer(data).keys())


def test_networks_may_be_tensordict_modules() -> None:
    keys = ["observation", ("next", "observation"), "action"]
    plain = small()
    wrapped = small(
        system_network=TensorDictModule(Scale(1.0, 1.0), ["observation", "action"], ["predicted"]),
        reward_network=TensorDictModule(Scale(1.0, -1.0, 10.0), keys, ["predicted_reward"]),
    )
    for one in (plain, wrapped):
        one.update_gate(0.0)
    assert torch.equal(plain.actor_loss(states(1.0))[0], wrapped.actor_loss(states(1.0))[0])


def test_system_net_starts_as_its_authors_have_it() -> None:
    net = SystemNet(3, 2, (5,))
    assert all((layer.bias == 0.001).all() for layer in net.net if isinstance(layer, nn.Linear))
    bound = math.sqrt(6 / (5 + 5))
    assert net.net[0].weight.abs().amax() <= bound
    assert len(small().model_params) == 2


# ---------------------------------------------------------------------- mistakes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data.set("observation", data["observation"] + float("nan")), "finite states, got 2 values"),
        (lambda data: data.set(("next", "reward"), torch.full((2, 1), torch.inf)), "finite rewards, got 2 values"),
        (lambda data: data[:1], "whole episodes"),
        (lambda data: episode([1.0], width=2), "width 1, got 2"),
    ],
)
def test_episodes_of_another_kind_are_refused(change: Callable[[TensorDict], TensorDict], message: str) -> None:
    loss = small()
    with pytest.raises(ValueError, match=message):
        loss.observe(change(episode([1.0, 1.0])))
    assert len(loss.returns) == 0


def test_a_missing_reward_network_is_refused() -> None:
    with pytest.raises(ValueError, match="Fork expected a reward_network, got none"):
        fork(td3(), reward_network=None)


def test_an_actor_of_several_keys_is_refused() -> None:
    policy = TensorDictModule(Scale(1.0, 1.0), ["observation", "goal"], ["action"])
    values = [TensorDictModule(Scale(1.0, 1.0), ["observation", "action"], ["state_action_value"]) for _ in range(2)]
    with pytest.raises(ValueError, match="reads one key"):
        fork(TD3Loss(policy, values, action_spec=SPEC))


@pytest.mark.parametrize("renamed_after", [False, True])
@pytest.mark.parametrize("base", [TD3Loss, DDPGLoss])
def test_keys_may_be_nested_and_renamed(base: type[TD3Loss | DDPGLoss], renamed_after: bool) -> None:
    state, act = ("agent", "state"), ("agent", "act")
    first = ("observation", "action") if renamed_after else (state, act)
    policy = TensorDictModule(Actor(6, 2, (8,)), [first[0]], [first[1]])
    values = [TensorDictModule(Critic(6, 2, (8,)), list(first), ["state_action_value"]) for _ in range(2)]
    loss = base.of_networks(policy, values, SPEC)
    if base is TD3Loss and not renamed_after:
        loss.set_keys(action=act)
    penalized = fork(loss)
    if renamed_after:
        penalized.set_keys(observation=state, action=act)
    data = TensorDict({state: torch.randn(5, 6), act: torch.randn(5, 2), "next": {"reward": torch.randn(5, 1)}}, [5])
    data["next", "agent", "state"] = torch.randn(5, 6)
    assert penalized.model_loss(data)[0].isfinite()
    data["next", "done"] = torch.arange(5)[:, None] == 4
    penalized.observe(data)
    assert len(penalized.returns) == 1
    if not renamed_after:
        penalized.update_gate(0.0)
        assert penalized.actor_loss(data)[0].isfinite()
