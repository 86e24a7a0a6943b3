"""The contract that every transform and every loss of the library passes, as base classes for tests."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable
from functools import cache
from typing import ClassVar

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, EnvBase, SerialEnv, Transform, TransformedEnv, check_env_specs
from torchrl.objectives import SoftUpdate, ValueEstimators

from uavrl.errors import UavrlError

NESTINGS: dict[str, Callable[[Callable[[], EnvBase], Callable[[], Transform]], EnvBase]] = {
    "single": lambda env, transform: TransformedEnv(env(), transform()),
    "composed": lambda env, transform: TransformedEnv(env(), Compose(transform())),
    "in a serial one": lambda env, transform: SerialEnv(2, lambda: TransformedEnv(env(), transform())),
    "around a serial one": lambda env, transform: TransformedEnv(SerialEnv(2, env), transform()),
}


class TransformContract:
    """Subclass, and give ``make_transform``, ``make_env`` (batch-locked, emits the in-keys) and ``make_data``."""

    def make_transform(self) -> Transform:
        raise NotImplementedError

    @staticmethod
    def make_env() -> EnvBase:
        raise NotImplementedError

    def make_data(self, *batch: int) -> TensorDict:
        """Data that ``forward`` takes (stored transitions, or observations)."""
        raise NotImplementedError

    def out_key(self) -> str:
        return self.make_transform().out_keys[0]

    @pytest.mark.parametrize("nested", NESTINGS)
    def test_env_matches_its_specs(self, nested: str) -> None:
        check_env_specs(NESTINGS[nested](self.make_env, self.make_transform))

    def apply(self, transform: Transform, data: TensorDictBase) -> torch.Tensor | None:
        """The transform's output for data that it may modify."""
        return self.output(transform(data))

    def output(self, data: TensorDictBase) -> torch.Tensor | None:
        after = data.get(("next", self.out_key()), None)
        return data.get(self.out_key(), None) if after is None else after

    def expected(self, *batch: int) -> torch.Tensor:
        """The output of a new transform, which differs from the input."""
        before = self.output(self.make_data(*batch))
        after = self.apply(self.make_transform(), self.make_data(*batch))
        assert after is not None
        assert before is None or not torch.equal(before, after), "the transform does nothing"
        return after

    def test_any_batch_shape(self) -> None:
        deep = self.apply(self.make_transform(), self.make_data(6).reshape(3, 2))
        torch.testing.assert_close(deep, self.expected(6).reshape(deep.shape))

    def test_as_a_module_in_a_model(self) -> None:
        model = torch.nn.Sequential(self.make_transform())
        torch.testing.assert_close(self.output(model(self.make_data(4))), self.expected(4))

    def test_in_a_replay_buffer(self) -> None:
        buffer = ReplayBuffer(storage=LazyTensorStorage(8), batch_size=4, transform=self.make_transform())
        buffer.extend(self.make_data(8).set("row", torch.arange(8)))
        sample = buffer.sample()
        torch.testing.assert_close(self.output(sample), self.expected(8)[sample["row"]])

    def test_state_dict_round_trip(self) -> None:
        """After other data, which may have changed the state."""
        one, other = self.make_transform(), self.make_transform()
        self.apply(one, self.make_data(9))
        other.load_state_dict(one.state_dict())
        torch.testing.assert_close(self.apply(other, self.make_data(6)), self.apply(one, self.make_data(6)))

    def test_survives_a_deep_copy(self) -> None:
        copied = copy.deepcopy(self.make_transform())
        torch.testing.assert_close(self.apply(copied, self.make_data(6)), self.expected(6))


@cache
def _seeded(contract: type[LossContract], settings: tuple[tuple[str, object], ...]) -> torch.nn.Module:
    torch.manual_seed(0)
    return contract().make_loss(**dict(settings))


class ThroughTimeContract(TransformContract):
    """Of a transform that follows scans through time."""

    def apply(self, transform: Transform, data: TensorDictBase) -> torch.Tensor:
        """As an environment would."""
        return transform._call(data)[transform.out_keys[0]]

    def test_as_a_module_in_a_model(self) -> None:
        with pytest.raises(UavrlError, match="append it to an environment"):
            torch.nn.Sequential(self.make_transform())(self.make_data(4))

    def test_in_a_replay_buffer(self) -> None:
        buffer = ReplayBuffer(batch_size=4, transform=self.make_transform())
        with pytest.raises(UavrlError, match="follows scans through time"):
            buffer.extend(self.make_data(8))
            buffer.sample()


class LossContract:
    """Subclass, and give ``make_loss``; the loss reads the usual keys of a transition.

    ``methods`` names each ``*_loss(tensordict)`` with the group of parameters that its gradient reaches;
    ``groups`` says which parameters these are. ``compiled`` are those that ``make check`` takes through
    ``torch.compile``; the slow tests take all of them through inductor.
    """

    observations, actions = 6, 2
    methods: ClassVar[dict[str, str]] = {"value_loss": "critic", "actor_loss": "actor"}
    compiled: ClassVar[tuple[str, ...]] = ()

    def make_loss(self, **kwargs: object) -> torch.nn.Module:
        raise NotImplementedError

    def groups(self, loss: torch.nn.Module) -> dict[str, list[torch.Tensor]]:
        found = {
            "actor": list(loss.actor_network_params.values(True, True)),
            "critic": list(loss.critic_network_params.values(True, True)),
        }
        return found | ({"model": list(loss.model_params)} if "model" in self.methods.values() else {})

    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        generator = torch.Generator().manual_seed(0)

        def normal(width: int) -> torch.Tensor:
            return torch.randn(size, width, generator=generator, dtype=dtype)

        terminated = torch.arange(size)[:, None] % 3 == 2
        data = {"observation": normal(self.observations), "action": normal(self.actions).clamp(-2, 2)}
        following = {"observation": normal(self.observations), "reward": normal(1)}
        flags = {"done": terminated.clone(), "terminated": terminated}
        return TensorDict({**data, "next": following | flags}, [size])

    def evaluate(self, loss: torch.nn.Module, method: str, data: TensorDictBase | None = None) -> torch.Tensor:
        """The method's loss, with the same noise at each call."""
        torch.manual_seed(1)
        return getattr(loss, method)(self.make_data() if data is None else data)[0]

    def seeded_loss(self, **kwargs: object) -> torch.nn.Module:
        """A copy of a loss that is made, and trained, once, with the same networks for every caller."""
        return copy.deepcopy(_seeded(type(self), tuple(kwargs.items())))

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        given = [mark.args[0] for mark in metafunc.definition.iter_markers("parametrize")]
        if "method" in metafunc.fixturenames and "method" not in given:
            metafunc.parametrize("method", list(self.methods))

    @pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
    def test_reduction(self, method: str, reduction: str) -> None:
        each = self.evaluate(self.seeded_loss(reduction="none"), method)
        assert each.shape[-1] == 5
        expected = {"none": each, "mean": each.mean(), "sum": each.sum()}[reduction]
        torch.testing.assert_close(self.evaluate(self.seeded_loss(reduction=reduction), method), expected)

    def test_gradients_reach_only_what_they_should(self, method: str) -> None:
        loss = self.make_loss()
        self.evaluate(loss, method).backward()
        groups = self.groups(loss)
        reached = {id(p) for p in groups[self.methods[method]]}
        assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in groups[self.methods[method]])
        for name, value in [*loss.named_parameters(), *loss.named_buffers()]:
            assert value.grad is None or id(value) in reached or not value.grad.any(), name
        for name, group in groups.items():
            touched = [p.grad is not None and bool(p.grad.abs().sum() > 0) for p in group]
            assert any(touched) == (name == self.methods[method]), name

    def test_inputs_are_not_modified(self, method: str) -> None:
        data = self.make_data()
        before = data.clone()
        metadata = getattr(self.make_loss(), method)(data)[1]
        data = data.exclude("td_error")
        assert set(data.keys(True)) == set(before.keys(True))
        assert (data == before).all()
        assert method != "actor_loss" or (metadata and not any(v.requires_grad for v in metadata.values()))

    def test_priority_weights(self, method: str) -> None:
        """A weight of 0 takes a sample out of the loss."""
        loss = self.seeded_loss()
        data = self.make_data().set("priority_weight", torch.tensor([1.0, 1.0, 0.0, 1.0, 1.0]))
        each = self.evaluate(self.seeded_loss(reduction="none"), method)
        torch.testing.assert_close(self.evaluate(loss, method, data), each[..., [0, 1, 3, 4]].mean())

    def test_state_dict_round_trip(self, method: str) -> None:
        one, other = self.make_loss(), self.make_loss()
        assert not torch.equal(self.evaluate(one, method), self.evaluate(other, method))
        other.load_state_dict(one.state_dict())
        assert torch.equal(self.evaluate(one, method), self.evaluate(other, method))

    def test_forward_gives_each_loss(self) -> None:
        """From a tensordict and from keyword arguments, by two copies: a call may move statistics."""
        loss, data = self.make_loss(), self.make_data()
        other = copy.deepcopy(loss)
        torch.manual_seed(1)
        values = loss(**self.arguments(data))
        torch.manual_seed(1)
        losses = other(data)
        for key, value in zip(loss.out_keys, values, strict=True):
            torch.testing.assert_close(value, losses[key])
        expected = sorted(key for key in loss.out_keys if key.startswith("loss_"))
        assert sorted(key for key in losses.keys(True) if str(key).startswith("loss_")) == expected
        assert len(expected) >= 2

    def arguments(self, data: TensorDict) -> dict[str, torch.Tensor]:
        return {"_".join(k) if isinstance(k, tuple) else k: v for k, v in data.items(True, True)}

    def test_an_unknown_key_is_refused(self) -> None:
        with pytest.raises(ValueError, match="no_such_key"):
            self.make_loss().set_keys(no_such_key="observation")

    def test_out_keys_can_be_selected(self) -> None:
        loss = self.make_loss()
        every, wanted = list(loss.out_keys), loss.out_keys[:1]
        assert loss.select_out_keys(*wanted) is loss
        assert loss.out_keys == wanted
        assert sorted(loss(self.make_data()).keys()) == wanted
        assert loss(**self.arguments(self.make_data())).shape == ()
        assert self.make_loss().out_keys == every  # the selection is that of one instance
        loss.reset_out_keys()
        assert loss.out_keys == every
        assert set(every) <= set(loss(self.make_data()).keys())

    def test_parameters_are_drawn_anew_by_each_network(self) -> None:
        """Each linear layer as PyTorch draws it: within 1 / √inputs, and near it; targets are copies."""
        loss = self.seeded_loss()
        constant = ("log_alpha", "system_network_params.module.net.0.bias", "system_network_params.module.net.2.bias")
        drawn = {key: value.clone() for key, value in loss.named_parameters() if not key.endswith(constant)}
        loss.reset_parameters_recursive()
        new = dict(loss.named_parameters())
        assert drawn and [key for key in drawn if torch.equal(drawn[key], new[key])] == []
        for key, value in new.items():
            if key.endswith("weight") and value.shape[-1] > 1 and "system_network" not in key:
                assert value.abs().amax() * value.shape[-1] ** 0.5 <= 1.00001, key
                # of fewer weights the largest may well be smaller
                assert value.numel() < 32 or value.abs().amax() * value.shape[-1] ** 0.5 > 0.6, key
            assert value.ndim < 3 or not torch.equal(*value), key  # two critics
        for key, target in loss.state_dict().items():
            if "target_" in key and isinstance(target, torch.Tensor) and key.replace("target_", "") in new:
                assert torch.equal(target, new[key.replace("target_", "")]), key

    def test_a_deep_copy_and_double_precision(self, method: str) -> None:
        loss = self.make_loss()
        copied = copy.deepcopy(loss)
        assert torch.equal(self.evaluate(loss, method), self.evaluate(copied, method))
        assert self.evaluate(copied.double(), method, self.make_data(torch.float64)).dtype == torch.float64

    @pytest.mark.gpu
    def test_cuda(self, method: str) -> None:
        loss = self.make_loss().to("cuda")
        value = self.evaluate(loss, method, self.make_data().to("cuda"))
        assert value.is_cuda and value.isfinite()


class ActorCriticLossContract(LossContract):
    """The contract of losses that have an actor, critics and targets, and of penalties around them."""

    def test_the_value_estimator_can_be_changed(self) -> None:
        data, loss = self.make_data(), self.seeded_loss()
        assert loss.make_value_estimator(ValueEstimators.TD0, gamma=0.0) is loss
        assert loss.value_estimator.gamma == 0.0
        target = loss.value_loss(data)[1]["target_value"]
        torch.testing.assert_close(target, data["next", "reward"].squeeze(-1))

    def test_a_soft_update_moves_the_targets(self) -> None:
        """TorchRL's updater moves each target by τ towards its own source."""
        loss = self.make_loss()
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # TorchRL warns while no updater is associated
            updater = SoftUpdate(loss, tau=0.25)
            moving = [p for key, p in loss.named_parameters() if "log_alpha" not in key]
            with torch.no_grad():
                for p in moving:
                    p.add_(torch.rand_like(p))
            before = {key: value.clone() for key, value in loss.state_dict().items() if not key.endswith("extra_state")}
            updater.step()
            loss(self.make_data())
        after = loss.state_dict()
        targets = [key for key in before if ".target_" in f".{key}"]
        assert targets
        for key in targets:
            expected = 0.75 * before[key] + 0.25 * before[key.replace("target_", "")]
            torch.testing.assert_close(after[key], expected)
            assert before[key].numel() == 0 or not torch.equal(before[key], after[key])

    def test_all_keys_can_be_renamed(self, method: str) -> None:
        """Each entry of a transition that the loss reads, one after the other."""
        expected = self.evaluate(self.seeded_loss(), method)
        for name in ("reward", "done", "terminated"):
            data, loss = self.make_data(), self.seeded_loss()
            data["next", f"my_{name}"] = data["next"].pop(name)
            loss.set_keys(**{name: f"my_{name}"})
            assert torch.equal(self.evaluate(loss, method, data), expected), name
            assert ("next", f"my_{name}") in loss.in_keys, name
            loss.set_keys(**{name: None})
            assert torch.equal(self.evaluate(loss, method), expected), name

    def test_a_renamed_priority_is_written(self) -> None:
        loss, data = self.make_loss(), self.make_data()
        loss.set_keys(priority="urgency")
        loss(data)
        assert data["urgency"].shape == data.batch_size
        assert "td_error" not in data.keys()  # noqa: SIM118
