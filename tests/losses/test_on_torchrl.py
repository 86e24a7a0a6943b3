"""Actor penalties around TorchRL's own losses: what they leave as it was, what they add, and what is refused."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import Tensor
from torchrl.data import Bounded
from torchrl.modules import OneHotCategorical, QValueActor, ValueOperator
from torchrl.objectives import (
    CrossQLoss,
    DDPGLoss,
    DiscreteSACLoss,
    DQNLoss,
    HardUpdate,
    LossModule,
    PPOLoss,
    SACLoss,
    SoftUpdate,
    TD3BCLoss,
    TD3Loss,
    ValueEstimators,
)  # fmt: skip

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import SPEC, Scale, actor, critics, episodes, fork, lifeguard, states, stochastic_actor
from tests.helpers.torchrl_losses import BASES, PENALTIES, activated
from uavrl.errors import UavrlError
from uavrl.losses import ActionRate, ActorPenalty, Fork, Imitation, LifeGuard


class _Contract(ActorCriticLossContract):
    """All four penalties, one on the other, around a loss of TorchRL; they all count."""

    base: ClassVar[str] = "td3"

    def make_loss(self, **options: Any) -> ActorPenalty:
        loss = BASES[self.base](**options)
        for add in PENALTIES.values():
            loss = add(loss)
        return activated(loss)

    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        data = super().make_data(dtype, size)
        data["next", "collided"] = data["next", "terminated"].clone()
        return data.set("demonstrator_action", data["action"].flip(-1))

    def test_parameters_are_drawn_anew_by_each_network(self) -> None:
        pytest.skip("TorchRL's losses draw the parameters of stacked critics in their own way")

    def test_the_value_estimator_can_be_changed(self) -> None:
        """Without a discount the target is the reward; the loss of the critics by hand."""
        loss = self.seeded_loss(loss_function="l2", reduction="sum")
        assert loss.make_value_estimator(ValueEstimators.TD0, gamma=0.0) is loss
        assert loss.value_estimator.gamma == 0.0 and loss.value_type == ValueEstimators.TD0
        data = self.make_data()
        losses = loss(data.clone())
        params = loss.critic_network_params
        critic = getattr(loss.unwrapped, "qvalue_network" if self.base != "ddpg" else "value_network")
        expected = torch.zeros(())
        for one in params.unbind(0) if params.batch_dims else (params,):
            with one.to_module(critic, preserve_module_state=False):
                value = critic(data.clone())["state_action_value"]
            expected = expected + (value - data["next", "reward"]).square().sum()
        torch.testing.assert_close(losses["loss_value" if self.base == "ddpg" else "loss_qvalue"], expected)


class TestAllOnTD3(_Contract):
    pass


class TestAllOnDDPG(_Contract):
    base = "ddpg"
    methods: ClassVar[dict[str, str]] = {"loss_value": "critic", "loss_actor": "actor"}


class TestAllOnSAC(_Contract):
    base = "sac"
    methods: ClassVar[dict[str, str]] = {"qvalue_v2_loss": "critic", "actor_loss": "actor"}


class _Unweighted(_Contract):
    def test_priority_weights(self, method: str) -> None:
        """TorchRL's class reads none, so that the terms have none either."""
        data = self.make_data()
        weighted = data.clone().set("priority_weight", torch.tensor([1.0, 1.0, 0.0, 1.0, 1.0]))
        loss = self.seeded_loss()
        assert torch.equal(self.evaluate(loss, method, data), self.evaluate(loss, method, weighted))


class TestAllOnREDQ(_Unweighted):
    base = "redq"
    methods: ClassVar[dict[str, str]] = {"actor_loss": "actor"}


class TestAllOnCrossQ(_Unweighted):
    base = "crossq"
    methods: ClassVar[dict[str, str]] = {"qvalue_loss": "critic", "actor_loss": "actor"}

    def test_a_soft_update_moves_the_targets(self) -> None:
        """There are none, and TorchRL says so."""
        with pytest.raises(RuntimeError, match="Did not find any target"):
            SoftUpdate(self.make_loss(), tau=0.25)


# ---------------------------------------------------------------------- what stays


def forward(loss: LossModule, data: TensorDict) -> dict[str, Tensor]:
    torch.manual_seed(1)
    return dict(loss(data.clone()).items())


def gradients(loss: LossModule, losses: dict[str, Tensor]) -> list[Tensor | None]:
    """Of all losses of TorchRL's class together, for each of its parameters."""
    parts = [value.mean() for name, value in losses.items() if name.startswith("loss_") and "reward" not in name]
    params = list(loss.parameters())
    return list(torch.autograd.grad(sum(parts), params, allow_unused=True))


def same(one: list[Tensor | None], other: list[Tensor | None]) -> list[bool]:
    return [
        a is b is None or (a is not None and b is not None and torch.equal(a, b))
        for a, b in zip(one, other, strict=True)
    ]


@pytest.mark.parametrize("reduction", ["mean", "none"])
@pytest.mark.parametrize("name", BASES)
@pytest.mark.filterwarnings("ignore:.*with reduction='none' cannot include scalar values")
def test_a_penalty_that_is_not_active_leaves_values_and_gradients_bit_by_bit(name: str, reduction: str) -> None:
    """FORK before its models are good, LifeGuard before it was evaluated, both at once."""
    data = TestAllOnTD3().make_data()
    base = BASES[name](reduction=reduction)
    expected = forward(base, data)
    for loss in (fork(base), lifeguard(base), lifeguard(fork(base))):
        found = forward(loss, data)
        assert not any(penalty.active for penalty in loss.penalties)
        assert {key for key in expected if not torch.equal(expected[key], found[key])} == set()
        assert all(same(gradients(base, expected), gradients(base, {key: found[key] for key in expected})))
        expected = forward(base, data)  # a graph is used once


# ---------------------------------------------------------------------- what is added


@pytest.mark.parametrize("penalty", PENALTIES)
@pytest.mark.parametrize("name", BASES)
def test_a_penalty_changes_the_actors_loss_alone_and_by_its_term(name: str, penalty: str) -> None:
    """By the mean of the term at the actor's action, times the mean size of the objective where it is relative."""
    torch.manual_seed(0)
    data, base = TestAllOnTD3().make_data(), BASES[name]()
    loss = activated(PENALTIES[penalty](base))
    plain, plain_grads = (result := forward(base, data)), gradients(base, result)
    torch.manual_seed(1)
    base(data.clone())  # TorchRL's class draws first; the action of the term comes after it
    acted = loss.act(data)
    term = loss.actor_term(acted)[0]
    if loss.relative:
        term = term * objective(loss, acted).abs().mean()
    penalized = forward(loss, data)
    torch.testing.assert_close(penalized["loss_actor"], plain["loss_actor"] + term.mean())
    unchanged = set(plain) - {"loss_actor"}
    assert {key for key in unchanged if not torch.equal(plain[key], penalized[key])} == set()
    added = torch.autograd.grad(term.mean(), list(base.parameters()), allow_unused=True)
    found = gradients(base, {key: penalized[key] for key in plain})
    names = [key for key, _ in base.named_parameters()]
    for key, before, more, after in zip(names, plain_grads, added, found, strict=True):
        if key.startswith("actor_network"):
            torch.testing.assert_close(after, before + more)
        else:
            assert more is None and (after is before is None or torch.equal(after, before)), key
    assert any(more is not None and more.abs().sum() > 0 for more in added)


def objective(loss: ActorPenalty, acted: TensorDict) -> Tensor:
    """-Q(s, a) of the first critic, or α log π - Q(s, a) with the smallest or, for REDQ, the mean."""
    base, params = loss.unwrapped, loss.critic_network_params
    name = "value_network" if not params.batch_dims else "qvalue_network"
    critic, values = getattr(base, name), []
    for one in params.detach().unbind(0) if params.batch_dims else (params.detach(),):
        with one.to_module(critic, preserve_module_state=False):
            values.append(critic(acted.clone())["state_action_value"].squeeze(-1))
    if not hasattr(base, "log_alpha"):
        return -values[0].detach()
    stacked = torch.stack(values)
    value = stacked.mean(0) if "REDQ" in type(base).__name__ else stacked.min(0).values
    return (base.log_alpha.exp() * acted["_log_prob"] - value).detach()


def small_td3(**options: Any) -> TD3Loss:
    """TorchRL's, with μ(s) = 2 s and Q1(s, a) = s + 3 a."""
    policy = TensorDictModule(Scale(2.0), ["observation"], ["action"])
    values = [
        TensorDictModule(Scale(*factors), ["observation", "action"], ["state_action_value"])
        for factors in ((1.0, 3.0), (7.0, 7.0))
    ]
    return TD3Loss(policy, values, action_spec=Bounded(-9.0, 9.0, (1,)), **options)


def test_fork_by_hand() -> None:
    """As for uavrl's TD3: -7 - 0.5 (18 + 0.5 · 54 + 0.25 · 63) = -37.375, and a slope of -27.375 through the model."""
    loss = Fork(
        small_td3(),
        system_network=Scale(1.0, 1.0),
        reward_network=Scale(1.0, -1.0, 10.0),
        observations=1,
        max_reward=10.0,
        gamma=0.5,
        base_weight=0.5,
        backprop_through_model=True,
    )
    assert loss.actor_loss(states(1.0))[0].item() == -7.0
    loss.update_gate(0.0)
    value, metadata = loss.actor_loss(states(1.0))
    assert value.item() == pytest.approx(-37.375)
    assert metadata["fork_term"].item() == pytest.approx(-30.375)
    value.backward()
    assert loss.actor_network_params["module", "factors"].grad.item() == pytest.approx(-27.375)


def test_imitation_and_action_rate_by_hand() -> None:
    """s = 1: μ = 2, Q = 7.

    Imitation of 4 up to 2: 0.5 · 7 · ((2 - 4) / 2)² = 3.5, hence -3.5. The last action is 2 · 1, as the new one is: no
    more. With a limit of 1 in the action rate the last is 1: 0.1 · 3.5 · (2 - 1)² = 0.35, hence -3.15.
    """
    data = states(1.0).set("demonstrator_action", torch.tensor([[4.0]]))
    cloned = Imitation(small_td3(), limit=2.0, weight=0.5)
    assert cloned.actor_loss(data)[0].item() == pytest.approx(-3.5)
    assert ActionRate(cloned, actions=1, limit=2.0, weight=0.1).actor_loss(data)[0].item() == pytest.approx(-3.5)
    assert ActionRate(cloned, actions=1, limit=1.0, weight=0.1).actor_loss(data)[0].item() == pytest.approx(-3.15)


def test_lifeguard_by_hand() -> None:
    """A logit of 0 is a probability of a half: -7 + 8 / 2 = -3.

    Features (s, a) = (0.5, 0.5), scaled from (0, 2) and (0, 4), and w = (2, -2): the term's slope in the action is
    8 · ¼ · (-2) / 4 = -1. μ(s) = θ s with s = 1, and Q's slope is 3: the slope in θ is -3 - 1.
    """
    loss = LifeGuard(small_td3(), observations=1, actions=1, penalty_weight=8.0)
    loss.classifier.scaler.low.copy_(torch.tensor([0.0, 0.0]))
    loss.classifier.scaler.high.copy_(torch.tensor([2.0, 4.0]))
    loss.classifier.model.weight.copy_(torch.tensor([2.0, -2.0]))
    loss._active = True
    value, _ = loss.actor_loss(states(1.0))
    assert value.item() == pytest.approx(-3.0)
    value.backward()
    assert loss.actor_network_params["module", "factors"].grad.item() == pytest.approx(-4.0)


def test_penalties_read_the_keys_of_the_networks() -> None:
    """TorchRL's DDPGLoss has no key for the action: it is what the actor writes and the critic reads."""
    state, action = ("agent", "state"), ("agent", "act")
    policy = TensorDictModule(Scale(2.0), [state], [action])
    critic = TensorDictModule(Scale(1.0, 3.0), [state, action], ["state_action_value"])
    loss = LifeGuard(DDPGLoss(policy, critic), observations=1, actions=1)
    assert (loss.tensor_keys.observation, loss.tensor_keys.action) == (state, action)
    loss._active = True
    loss.classifier.scaler.update(torch.zeros(2, 2))
    data = TensorDict({state: torch.ones(3, 1)}, [3])
    assert loss.actor_loss(data)[0].item() == pytest.approx(-7.0 + 5.0)
    assert torch.equal(loss.loss_actor(data)[0], loss.actor_loss(data)[0]), "TorchRL's name of it"


def test_td3_with_behaviour_cloning_keeps_its_own_objective() -> None:
    """A class that was not thought of: its actor's loss reads the action of the data."""
    base, data = TD3BCLoss(actor(), critics(), action_spec=SPEC), TestAllOnTD3().make_data()
    loss = ActionRate(base, actions=2, limit=2.0, weight=0.0)
    other = data.clone().set("action", data["action"] + 1.0)
    assert torch.equal(loss.actor_loss(data)[0], base.actor_loss(data)[0])
    assert not torch.equal(loss.actor_loss(data)[0], loss.actor_loss(other)[0])


def test_the_statistics_of_crossqs_critics_do_not_move() -> None:
    """Batch normalisation, at FORK's predicted states."""
    keys = ["observation", "action"], ["state_action_value"]
    values = [TensorDictModule(NormalizedCritic(), *keys) for _ in range(2)]
    loss = fork(CrossQLoss(stochastic_actor(), values, action_spec=SPEC))
    loss.update_gate(0.0)
    before = {key: value.clone() for key, value in loss.named_buffers() if "running" in key}
    loss.actor_loss(TestAllOnTD3().make_data())
    after = dict(loss.named_buffers())
    assert before and all(torch.equal(value, after[key]) for key, value in before.items())
    assert loss.qvalue_network.training


class NormalizedCritic(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.net = torch.nn.Sequential(torch.nn.BatchNorm1d(8), torch.nn.Linear(8, 1))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return self.net(torch.cat([observation, action], -1))


# ---------------------------------------------------------------------- how TorchRL uses a loss


@pytest.mark.parametrize("name", ["td3", "ddpg", "sac", "redq", "crossq"])
def test_a_plain_training_loop(name: str) -> None:
    """Two optimisers, or three, one backward pass over all losses, and TorchRL's updater: everything moves."""
    torch.manual_seed(0)
    loss = _contract(name).make_loss()
    groups = {"actor": loss.actor_network_params, "critic": loss.critic_network_params}
    optimizers = {key: torch.optim.Adam(params.values(True, True), lr=1e-2) for key, params in groups.items()}
    if hasattr(loss, "log_alpha"):
        optimizers["alpha"] = torch.optim.Adam([loss.log_alpha], lr=1e-2)
        assert loss.alpha_params == [loss.log_alpha]
    updater = None if name == "crossq" else SoftUpdate(loss, tau=0.5)
    data = _contract(name).make_data()
    loss(data.clone())  # TorchRL's classes make their value estimator and target entropy when they first need them
    before = copy.deepcopy(loss.state_dict())
    for _ in range(2):
        losses = loss(data.clone())
        sum(value for key, value in losses.items() if key.startswith("loss_")).backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad()
        if updater is not None:
            updater.step()
    moved = {
        key
        for key, value in loss.state_dict().items()
        if isinstance(value, Tensor) and not torch.equal(value, before[key])
    }
    unwrapped = "base.base.base.base."
    expected = {f"{unwrapped}{key}" for key, value in loss.unwrapped.named_parameters()}
    expected |= {key for key in before if key.startswith(f"{unwrapped}target_") and "weight" in key}
    assert expected <= moved | {key for key in expected if key.endswith("bias") and "target_" in key}


def _contract(name: str) -> _Contract:
    kinds = {kind.base: kind for kind in (TestAllOnTD3, TestAllOnDDPG, TestAllOnSAC, TestAllOnREDQ, TestAllOnCrossQ)}
    return kinds[name]()


def test_networks_go_out_and_come_back() -> None:
    """TorchRL's way from functional parameters to a module and back."""
    loss, data = TestAllOnTD3().make_loss(), TestAllOnTD3().make_data()
    network = loss.get_stateful_net("actor_network")
    torch.testing.assert_close(network(data.clone())["action"], loss.act(data)["action"])
    other = TestAllOnTD3().make_loss()
    other.from_stateful_net("actor_network", network)
    assert torch.equal(other.act(data)["action"], loss.act(data)["action"])


@pytest.mark.parametrize("below", [False, True])
def test_a_hard_update_copies(below: bool) -> None:
    """Made of the penalties, or of the loss below them."""
    loss = lifeguard(fork(BASES["td3"]()))
    updater = HardUpdate(loss.unwrapped if below else loss, value_network_update_interval=1)
    with torch.no_grad():
        for p in loss.qvalue_network_params.values(True, True):
            p.add_(1.0)
    networks, targets = (
        [*params.values(True, True)] for params in (loss.qvalue_network_params, loss.target_qvalue_network_params)
    )
    updater.step()  # TorchRL counts to the interval first
    assert not any(torch.equal(*pair) for pair in zip(networks, targets, strict=True))
    updater.step()
    assert all(torch.equal(*pair) for pair in zip(networks, targets, strict=True))


@pytest.mark.parametrize("value_type", [ValueEstimators.TD0, ValueEstimators.TD1, ValueEstimators.TDLambda])
def test_value_estimators(value_type: ValueEstimators) -> None:
    loss, base = lifeguard(BASES["td3"]()), None
    base = loss.unwrapped
    loss.make_value_estimator(value_type, gamma=0.9)
    assert loss.value_estimator is base.value_estimator
    assert loss.make_value_estimator(loss.value_type, gamma=0.5).value_estimator.gamma == 0.5
    data = TestAllOnTD3().make_data().reshape(1, 5)
    data["next", "done"][:, -1] = True
    torch.manual_seed(0)
    expected = base.value_loss(data)[0]
    torch.manual_seed(0)
    assert torch.equal(loss.value_loss(data)[0], expected)


@pytest.mark.parametrize("name", ["td3", "ddpg", "sac", "redq", "crossq"])
def test_all_of_torchrls_keys_can_be_set(name: str) -> None:
    loss = lifeguard(BASES[name]())
    for key in loss.unwrapped._AcceptedKeys.__dataclass_fields__:
        loss.set_keys(**{key: f"my_{key}"})
        assert getattr(loss.unwrapped.tensor_keys, key) == f"my_{key}"


def test_one_of_torchrls_own_critics_and_several_from_one() -> None:
    """TorchRL draws the weights of the critics again; the penalties take what it made."""
    loss = Imitation(TD3Loss(actor(), critics()[0], num_qvalue_nets=3, action_spec=SPEC), limit=2.0)
    assert loss.qvalue_network_params.batch_size == (3,)
    assert loss(TestAllOnTD3().make_data())["loss_actor"].isfinite()


# ---------------------------------------------------------------------- what is refused


def ppo() -> LossModule:
    return PPOLoss(stochastic_actor(), ValueOperator(torch.nn.Linear(6, 1), in_keys=["observation"]))


def dqn() -> LossModule:
    return DQNLoss(
        QValueActor(torch.nn.Linear(6, 2), in_keys=["observation"], action_space="one-hot"), action_space="one-hot"
    )


def one_hot_actor() -> ProbabilisticTensorDictSequential:
    return ProbabilisticTensorDictSequential(
        TensorDictModule(torch.nn.Linear(6, 2), ["observation"], ["logits"]),
        ProbabilisticTensorDictModule(
            ["logits"], ["action"], distribution_class=OneHotCategorical, return_log_prob=True
        ),
    )


def discrete_sac() -> LossModule:
    values = TensorDictModule(torch.nn.Linear(6, 2), ["observation"], ["action_value"])
    return DiscreteSACLoss(one_hot_actor(), values, action_space="one-hot", num_actions=2)


@pytest.mark.parametrize("penalty", PENALTIES)
@pytest.mark.parametrize("make", [ppo, dqn, discrete_sac, partial(torch.nn.Linear, 2, 2)])
def test_losses_of_another_kind_are_refused_in_a_sentence(make: Callable[[], Any], penalty: str) -> None:
    loss = make()
    with pytest.raises(
        UavrlError, match=rf"needs a loss that has an actor and a critic .* {type(loss).__name__} is none"
    ):
        PENALTIES[penalty](loss)


def test_actions_without_a_gradient_are_refused() -> None:
    loss = Imitation(SACLoss(one_hot_actor(), critics(), action_spec=SPEC), limit=1.0)
    with pytest.raises(UavrlError, match="OneHotCategorical have none"):
        loss.act(TestAllOnTD3().make_data())


def test_a_penalty_that_replaces_the_objective_is_refused() -> None:
    class Other(ActionRate):
        def actor_objective(self, acted, *, target=False):  # type: ignore[no-untyped-def]
            return super().actor_objective(acted, target=True)

    with pytest.raises(UavrlError, match="Other replaces the actor's objective"):
        Other(BASES["td3"](), actions=2)


def test_observe_and_fit_reach_a_lifeguard_around_torchrls_loss() -> None:
    loss = activated(lifeguard(BASES["sac"](), model="mlp", model_lr=1e-2))
    assert loss.diagnostics()["lifeguard_active"] == 1.0 and len(loss.collisions) == 80
    assert loss(TestAllOnTD3().make_data())["loss_lifeguard"].isfinite()
    assert episodes(1).shape == (5,)
