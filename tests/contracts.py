"""The contract that every transform and every loss of the library passes, as base classes for tests."""

from __future__ import annotations

import copy

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, EnvBase, ParallelEnv, SerialEnv, Transform, TransformedEnv, check_env_specs


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

    def test_single_env_matches_its_specs(self) -> None:
        check_env_specs(TransformedEnv(self.make_env(), self.make_transform()))

    def test_composed_env_matches_its_specs(self) -> None:
        check_env_specs(TransformedEnv(self.make_env(), Compose(self.make_transform())))

    def test_serial_env_matches_its_specs(self) -> None:
        check_env_specs(SerialEnv(2, lambda: TransformedEnv(self.make_env(), self.make_transform())))

    def test_around_serial_env_matches_its_specs(self) -> None:
        check_env_specs(TransformedEnv(SerialEnv(2, self.make_env), self.make_transform()))

    def test_parallel_env_matches_its_specs(self) -> None:
        env = ParallelEnv(2, _Make(type(self)), mp_start_method="fork")
        try:
            check_env_specs(env)
        finally:
            env.close()

    def test_any_batch_shape(self) -> None:
        transform = self.make_transform()
        flat = transform(self.make_data(6))
        deep = transform(self.make_data(6).reshape(3, 2))
        key = self._forward_key(flat)
        torch.testing.assert_close(flat[key].reshape(deep[key].shape), deep[key])

    def test_as_a_module_in_a_model(self) -> None:
        data = torch.nn.Sequential(self.make_transform())(self.make_data(4))
        assert self._forward_key(data) in data.keys(True)

    def test_in_a_replay_buffer(self) -> None:
        buffer = ReplayBuffer(storage=LazyTensorStorage(8), batch_size=4, transform=self.make_transform())
        buffer.extend(self.make_data(8))
        assert self._forward_key(buffer.sample()) is not None

    def test_state_dict_round_trip(self) -> None:
        transform = self.make_transform()
        self.make_transform().load_state_dict(transform.state_dict())

    def test_survives_a_deep_copy(self) -> None:
        transform = copy.deepcopy(self.make_transform())
        assert self._forward_key(transform(self.make_data(3))) is not None

    def _forward_key(self, data: TensorDictBase) -> object:
        keys = list(data.keys(True))
        key = self.out_key()
        return ("next", key) if ("next", key) in keys else key if key in keys else None


class _Make:
    """A picklable constructor of the contract's transformed environment."""

    def __init__(self, contract: type[TransformContract]) -> None:
        self.contract = contract

    def __call__(self) -> EnvBase:
        contract = self.contract()
        return TransformedEnv(contract.make_env(), contract.make_transform())


class LossContract:
    """Subclass, and give ``make_loss``; the loss reads the usual keys of a transition."""

    observations, actions = 6, 2

    def make_loss(self, **kwargs: object) -> torch.nn.Module:
        raise NotImplementedError

    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        generator = torch.Generator().manual_seed(0)

        def normal(width: int) -> torch.Tensor:
            return torch.randn(size, width, generator=generator, dtype=dtype)

        terminated = torch.arange(size)[:, None] % 3 == 2
        return TensorDict(
            {
                "observation": normal(self.observations),
                "action": normal(self.actions).clamp(-2, 2),
                "next": {
                    "observation": normal(self.observations),
                    "reward": normal(1),
                    "done": terminated.clone(),
                    "terminated": terminated,
                },
            },
            [size],
        )

    @pytest.mark.parametrize("method", ["value_loss", "actor_loss"])
    @pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
    def test_reduction(self, method: str, reduction: str) -> None:
        def value(reduction: str) -> torch.Tensor:
            torch.manual_seed(0)
            loss = self.make_loss(reduction=reduction)
            torch.manual_seed(1)
            return getattr(loss, method)(self.make_data())[0]

        each = value("none")
        assert each.shape[-1] == 5
        expected = {"none": each, "mean": each.mean(), "sum": each.sum()}[reduction]
        torch.testing.assert_close(value(reduction), expected)

    def test_gradients_reach_only_what_they_should(self) -> None:
        for method, reached in (("value_loss", "critic"), ("actor_loss", "actor")):
            loss = self.make_loss()
            getattr(loss, method)(self.make_data())[0].backward()
            params = {"actor": loss.actor_network_params, "critic": loss.critic_network_params}
            for name, group in params.items():
                norms = [p.grad is not None and bool(p.grad.abs().sum() > 0) for p in group.values(True, True)]
                assert any(norms) == (name == reached), (method, name)
            for name, value in loss.named_buffers():
                assert value.grad is None, name

    @pytest.mark.parametrize("method", ["value_loss", "actor_loss"])
    def test_inputs_are_not_modified(self, method: str) -> None:
        data = self.make_data()
        before = data.clone()
        getattr(self.make_loss(), method)(data)
        data = data.exclude("td_error")
        assert set(data.keys(True)) == set(before.keys(True))
        assert (data == before).all()

    def test_state_dict_round_trip(self) -> None:
        torch.manual_seed(0)
        one = self.make_loss()
        other = self.make_loss()
        other.load_state_dict(one.state_dict())
        values: list[torch.Tensor] = []
        for loss in (one, other):
            torch.manual_seed(1)
            values.append(loss.value_loss(self.make_data())[0])
        assert torch.equal(values[0], values[1])

    def test_keyword_arguments(self) -> None:
        loss = self.make_loss()
        loss(**{"_".join(k) if isinstance(k, tuple) else k: v for k, v in self.make_data().items(True, True)})

    def test_keys_can_be_renamed(self) -> None:
        values: list[torch.Tensor] = []
        for rename in (False, True):
            torch.manual_seed(0)
            loss = self.make_loss()
            data = self.make_data()
            if rename:
                loss.set_keys(reward="gain")
                data["next", "gain"] = data["next"].pop("reward")
            torch.manual_seed(1)
            values.append(loss.value_loss(data)[0])
        assert torch.equal(values[0], values[1])

    def test_float64(self) -> None:
        loss = self.make_loss().double()
        assert loss.value_loss(self.make_data(torch.float64))[0].dtype == torch.float64

    @pytest.mark.gpu
    def test_cuda(self) -> None:
        loss = self.make_loss().to("cuda")
        assert loss.value_loss(self.make_data().to("cuda"))[0].is_cuda
