from __future__ import annotations

import inspect
from typing import Any, ClassVar

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl import objectives
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import ValueEstimators

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import SPEC, Scale, actor, critics, ddpg, fork, sac, stochastic_actor, td3
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss, DDPGLoss, Fork, Imitation, SACLoss, TD3Loss
from uavrl.models import GaussianActor


class TestTD3(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss", "actor_loss")

    def make_loss(self, **kwargs: object) -> TD3Loss:
        return td3(**kwargs)

    def test_time_outs_bootstrap(self) -> None:
        data, loss = self.make_data(), self.make_loss(policy_noise=0.0)
        reward = data["next", "reward"].squeeze(-1)
        data["next", "done"] = torch.ones(5, 1, dtype=torch.bool)
        data["next", "terminated"] = torch.zeros(5, 1, dtype=torch.bool)
        assert not torch.allclose(loss.value_loss(data)[1]["target_value"], reward)
        data["next", "terminated"] = torch.ones(5, 1, dtype=torch.bool)
        torch.testing.assert_close(loss.value_loss(data)[1]["target_value"].squeeze(), reward)


class TestDDPG(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss",)

    def make_loss(self, **kwargs: object) -> DDPGLoss:
        return ddpg(**kwargs)


class TestSAC(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss", "actor_loss")

    def make_loss(self, **kwargs: object) -> SACLoss:
        return sac(**kwargs)

    def test_temperature_falls_while_the_policy_is_too_random(self) -> None:
        """log π = 0 is an entropy above the target of -2: -log α (0 - 2) has the slope 2 in log α."""
        loss = self.make_loss()
        assert loss.target_entropy.item() == -2.0
        (loss.value_loss(self.make_data())[0] + loss.actor_loss(self.make_data())[0]).backward()
        assert loss.log_alpha.grad is None
        loss.alpha_loss(torch.zeros(5)).backward()
        assert [p.grad.item() for p in loss.alpha_params] == [2.0]
        assert self.make_loss(fixed_alpha=True).alpha_params == []

    def test_any_batch_shape(self) -> None:
        loss = self.make_loss(reduction="none")
        data = self.make_data(size=6)
        flat = loss._values(data, loss.qvalue_network_params)
        deep = loss._values(data.reshape(3, 2), loss.qvalue_network_params)
        torch.testing.assert_close(deep.reshape(2, 6), flat)
        assert loss.actor_loss(data.reshape(3, 2))[0].shape == (3, 2)

    def test_actions_stay_within_the_limits(self) -> None:
        actor, data = stochastic_actor(), self.make_data()
        data["observation"] *= 1000
        with set_exploration_type(ExplorationType.RANDOM):
            assert actor(data)["action"].abs().amax() <= 2.0
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            assert torch.equal(actor(data)["action"], actor(data)["action"])


@pytest.mark.parametrize(("kind", "make_actor"), [(TD3Loss, actor), (SACLoss, stochastic_actor)])
def test_another_number_of_critics_is_refused(kind: type[ActorCriticLoss], make_actor: object) -> None:
    with pytest.raises(ValueError, match="Expected a list of 2 critics, got 1: pass num_qvalue_nets=1"):
        kind(make_actor(), critics()[:1], action_spec=SPEC)


# ---------------------------------------------------------------------- TorchRL's signatures

KINDS = [(TD3Loss, objectives.TD3Loss, actor), (SACLoss, objectives.SACLoss, stochastic_actor)]


@pytest.mark.parametrize(("kind", "theirs", "make_actor"), KINDS)
def test_one_critic_or_a_list_as_in_torchrl(kind: Any, theirs: Any, make_actor: Any) -> None:
    """The critic that is given keeps its weights, where TorchRL draws them again; the others have weights of their own.

    They are drawn as PyTorch draws them, within 1 / √inputs of zero.
    """
    torch.manual_seed(0)
    one = critics()[0]
    given = one.module.net[0].weight.detach().clone()
    loss = kind(make_actor(), one, action_spec=SPEC, num_qvalue_nets=3)
    weights = loss.qvalue_network_params["module", "net", "0", "weight"]
    assert torch.equal(weights[0], given)
    assert (
        weights.shape
        == theirs(make_actor(), critics()[0], action_spec=SPEC, num_qvalue_nets=3)
        .qvalue_network_params["module", "net", "0", "weight"]
        .shape
    )
    for other in weights[1:]:
        assert not torch.equal(other, given) and other.abs().max() <= 8**-0.5
    assert not torch.equal(weights[1], weights[2])
    assert all(value.grad_fn is None for value in loss.qvalue_network_params.values(True, True))
    data = TestTD3().make_data()
    losses = loss(data)
    (losses["loss_actor"] + losses["loss_qvalue"]).backward()
    assert all(value.grad.abs().sum() > 0 for value in [loss.qvalue_network_params["module", "net", "0", "weight"]])
    assert kind(make_actor(), critics(), num_qvalue_nets=2, action_spec=SPEC).qvalue_network_params.batch_size == (2,)


def test_what_torchrl_can_omit_can_be_omitted() -> None:
    """Bounds in place of a spec, a spec that the actor has, None as a reduction, and a DDPG without a target actor."""
    assert TD3Loss(actor(), critics(), bounds=(-2.0, 2.0)).policy_noise.item() == pytest.approx(0.4)
    assert SACLoss(stochastic_actor(), critics()).target_entropy.item() == -2.0
    assert TD3Loss(actor(), critics(), action_spec=SPEC, reduction=None).reduction == "mean"
    loss = DDPGLoss(actor(), critics()[0], delay_actor=False)
    assert "target_actor_network_params" not in dict(loss.named_children())


def test_a_state_value_network_is_refused() -> None:
    with pytest.raises(UavrlError, match="leave value_network out"):
        SACLoss(stochastic_actor(), critics(), critics()[0], action_spec=SPEC)


def test_copies_that_cannot_differ_are_refused() -> None:
    critic = TensorDictModule(Scale(1.0, 1.0), ["observation", "action"], ["state_action_value"])
    with pytest.raises(UavrlError, match="pass a list of 2 critics"):
        TD3Loss(actor(), critic, action_spec=SPEC)


@pytest.mark.parametrize(
    ("make", "theirs"), [(td3, objectives.TD3Loss), (ddpg, objectives.DDPGLoss), (sac, objectives.SACLoss)]
)
def test_signatures_and_keys_are_torchrls(make: Any, theirs: Any) -> None:
    loss = make()
    ours, their = (inspect.signature(cls).parameters for cls in (type(loss), theirs))
    positional = [name for name, one in their.items() if one.kind is one.POSITIONAL_OR_KEYWORD]
    assert [name for name, one in ours.items() if one.kind is one.POSITIONAL_OR_KEYWORD] == positional
    assert [name for name, one in ours.items() if one.kind is one.VAR_KEYWORD] == ["kwargs"], "the others pass on"
    keys = set(theirs._AcceptedKeys.__dataclass_fields__)
    for key in keys - (
        {"state_action_value"} if theirs is objectives.DDPGLoss else set()
    ):  # its critic has to write it
        loss.set_keys(**{key: f"my_{key}"})
        assert getattr(loss.tensor_keys, key) == f"my_{key}"
        loss.set_keys(**{key: None})
    assert loss.make_value_estimator(ValueEstimators.TDLambda, gamma=0.5, lmbda=0.5).value_estimator.gamma == 0.5


# ---------------------------------------------------------------------- types of numbers


@pytest.mark.parametrize("inside", [False, True], ids=["backward outside", "backward inside"])
@pytest.mark.parametrize("method", ["value_loss", "actor_loss"])
@pytest.mark.parametrize("make", [td3, ddpg, sac])
def test_autocast(make: Any, method: str, inside: bool) -> None:
    """Products in bfloat16, within their precision of 1/256, and the gradients of the parameters in float32."""
    loss, contract = make(), TestTD3()
    expected = contract.evaluate(loss, method)
    with torch.autocast("cpu", torch.bfloat16):
        value = contract.evaluate(loss, method)
        if inside:
            value.backward()
    if not inside:
        value.backward()
    torch.testing.assert_close(value.float(), expected, atol=0.05, rtol=0.05)
    grads = [p.grad for p in loss.parameters() if p.grad is not None and p.grad.abs().sum() > 0]
    assert grads and all(grad.dtype == torch.float32 and grad.isfinite().all() for grad in grads)


def test_autocast_of_stacked_critics_is_that_of_one_by_one() -> None:
    """In type and in value."""
    loss, data = sac(), TestTD3().make_data()
    params = loss.qvalue_network_params
    with torch.autocast("cpu", torch.bfloat16):
        stacked = loss._values(data, params)
        for one, value in zip(params.unbind(0), stacked, strict=True):
            with one.to_module(loss.qvalue_network, preserve_module_state=False):
                single = loss.qvalue_network(data.clone())["state_action_value"].squeeze(-1)
            torch.testing.assert_close(value, single, atol=0.02, rtol=0.02)
            assert value.dtype == single.dtype == torch.bfloat16


@pytest.mark.parametrize("make", [td3, ddpg, sac, lambda: fork(td3()), lambda: Imitation(sac(), limit=2.0)])
def test_double_precision_as_the_default(make: Any) -> None:
    torch.set_default_dtype(torch.float64)
    try:
        loss, data = make(), TestTD3().make_data(torch.float64)
        data["demonstrator_action"] = data["action"].flip(-1)
        if isinstance(loss, Fork):
            loss.update_gate(0.0)
        losses = loss(data)
        sum(value for key, value in losses.items() if key.startswith("loss_")).backward()
    finally:
        torch.set_default_dtype(torch.float32)
    assert losses["loss_actor"].dtype == torch.float64
    assert all(p.grad.dtype == torch.float64 for p in loss.parameters() if p.grad is not None)


def test_gaussian_actor_bounds_its_deviation() -> None:
    actor = GaussianActor(3, 2, (4,), log_scale=(-1.0, 1.0))
    torch.nn.init.constant_(actor.net[-1].bias, 50.0)
    _, scale = actor(torch.zeros(1, 3))
    torch.testing.assert_close(scale, torch.full((1, 2), torch.e))
