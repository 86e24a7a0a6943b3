from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import tensor

from tests.helpers.contracts import TransformContract
from tests.helpers.small_env import SmallEnv
from uavrl.transforms import WalkerReward, walker_reward


class TestWalkerReward(TransformContract):
    def make_transform(self) -> WalkerReward:
        return WalkerReward()

    @staticmethod
    def make_env() -> SmallEnv:
        return SmallEnv()

    def make_data(self, *batch: int) -> TensorDict:
        generator = torch.Generator().manual_seed(0)
        fell = torch.rand(*batch, 1, generator=generator) > 0.7
        reward = torch.where(fell, -100.0, torch.rand(*batch, 1, generator=generator))
        return TensorDict({"next": {"reward": reward, "collided": fell}}, batch)

    def test_literal_values(self) -> None:
        """A fall is -5, whatever it was; the rest counts five times."""
        reward = walker_reward(tensor([0.3, -0.5, -100.0, -100.0]), tensor([False, False, True, False]))
        torch.testing.assert_close(reward, tensor([1.5, -2.5, -5.0, -500.0]))

    def test_given_data_stay_as_they_are(self) -> None:
        data = self.make_data(6)
        before = data.clone()
        self.make_transform()(data.copy())
        assert (data == before).all()

    def test_a_missing_key_is_named(self) -> None:
        with pytest.raises(KeyError, match="WalkerReward expected the keys"):
            self.make_transform()(self.make_data(2).exclude(("next", "collided")))

    def test_shapes_must_agree(self) -> None:
        with pytest.raises(ValueError, match="one flag a reward"):
            walker_reward(torch.zeros(3), torch.zeros(3, 1, dtype=torch.bool))
