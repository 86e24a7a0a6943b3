from __future__ import annotations

from typing import ClassVar

import pytest
import torch

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import SPEC, actor, critics, ddpg, td3
from uavrl.losses import DDPGLoss, TD3Loss


class TestTD3(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss", "actor_loss")

    def make_loss(self, **kwargs: object) -> TD3Loss:
        return td3(**kwargs)

    def test_time_outs_bootstrap(self) -> None:
        data = self.make_data()
        data["next", "done"] = torch.ones(5, 1, dtype=torch.bool)
        data["next", "terminated"] = torch.zeros(5, 1, dtype=torch.bool)
        loss = self.make_loss(policy_noise=0.0)
        target = loss.value_loss(data)[1]["target_value"]
        assert not torch.allclose(target, data["next", "reward"].squeeze(-1))
        data["next", "terminated"] = torch.ones(5, 1, dtype=torch.bool)
        target = loss.value_loss(data)[1]["target_value"]
        torch.testing.assert_close(target.squeeze(), data["next", "reward"].squeeze(-1))

    def test_another_number_of_critics_is_refused(self) -> None:
        with pytest.raises(ValueError, match="two critics"):
            TD3Loss(actor(), critics()[:1], action_spec=SPEC)


class TestDDPG(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ("value_loss",)

    def make_loss(self, **kwargs: object) -> DDPGLoss:
        return ddpg(**kwargs)
