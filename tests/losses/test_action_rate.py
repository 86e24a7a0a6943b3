"""The action-rate penalty: the value by hand, and where it leads the actor."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import td3
from uavrl.losses import ActionRate, Imitation


class TestContract(ActorCriticLossContract):
    def make_loss(self, **options: Any) -> ActionRate:
        return ActionRate(td3(**options), actions=2, limit=2.0)

    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        return super().make_data(dtype, size)


def test_the_term_by_hand() -> None:
    """The state ends with (0.5, -1), hence the last action with (1, -2); the actor's is (2, 0): (0.5² + 1²) / 2."""
    state = TensorDict({"observation": torch.tensor([[9.0, 9.0, 9.0, 9.0, 0.5, -1.0]])}, [1])
    term, metadata = ActionRate(td3(), actions=2, limit=2.0, weight=0.4).actor_term(
        state.set("action", torch.tensor([[2.0, 0.0]]))
    )
    torch.testing.assert_close(term, torch.tensor([0.4 * 0.625]))
    torch.testing.assert_close(metadata["action_rate"], torch.tensor([0.625]))


def test_it_has_the_size_of_the_objective_and_joins_imitation() -> None:
    data = TestContract().make_data()
    data.set("demonstrator_action", data["action"].flip(-1))
    loss = ActionRate(Imitation(TestContract().seeded_loss(reduction="none").base, limit=2.0), actions=2, limit=2.0)
    plain, _ = loss.base.actor_loss(data)
    rate = loss.actor_term(loss.act(data))[0]
    value, metadata = loss.actor_loss(data)
    torch.testing.assert_close(value, plain + plain.abs().mean() * rate)
    assert {"demonstrator_distance", "action_rate"} <= set(metadata)


def test_alone_it_keeps_the_last_action() -> None:
    torch.manual_seed(0)
    loss = ActionRate(td3(), actions=2, limit=2.0, weight=1e4)
    data = TestContract().make_data(size=64)
    data["observation"][:, -2:].uniform_(-0.9, 0.9)
    adam = torch.optim.Adam(list(loss.actor_network_params.values(True, True)), lr=1e-2)
    for _ in range(300):
        adam.zero_grad()
        loss.actor_loss(data)[0].backward()
        adam.step()
    assert loss.actor_loss(data)[1]["action_rate"].mean() < 0.01
