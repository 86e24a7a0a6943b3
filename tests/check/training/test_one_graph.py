"""``torch.compile`` takes a whole loss with any penalties around it in one graph, and gives what the loss says."""

from __future__ import annotations

import copy
from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from walker.fork import BipedalFork

from tests.helpers.losses import ddpg, episodes, fork, lifeguard, sac, sampler, td3
from uavrl.losses import ActorCriticLoss, ActorPenalty, Fork, Imitation, LifeGuard
from uavrl.models import SystemNet


def imitation(base: ActorCriticLoss) -> Imitation:
    return Imitation(base, limit=2.0)


def opening(base: ActorCriticLoss, **kwargs: object) -> Fork:
    """FORK whose gate opens where the next states are not far off."""
    return fork(base, threshold=10.0, **kwargs)


def variant(base: ActorCriticLoss) -> Fork:
    return BipedalFork(base, system_network=SystemNet(6, 2, (8,)), observations=6, max_reward=300.0, threshold=10.0)


def mlp_lifeguard(base: ActorCriticLoss) -> LifeGuard:
    return lifeguard(base, model="mlp")


LOSSES: dict[str, Callable[[], ActorCriticLoss]] = {
    "td3": td3,
    "ddpg": ddpg,
    "sac": sac,
    "fork": lambda: opening(td3()),
    "fork through its model": lambda: opening(td3(), backprop_through_model=True),
    "a variant of FORK": lambda: variant(td3()),
    "lifeguard": lambda: lifeguard(td3()),
    "lifeguard, mlp": lambda: mlp_lifeguard(td3()),
    "imitation": lambda: imitation(td3()),
    "all on td3": lambda: imitation(lifeguard(opening(td3()))),
    "all on ddpg": lambda: mlp_lifeguard(opening(imitation(ddpg()))),
    "all on sac": lambda: opening(lifeguard(imitation(sac()))),
}


def told(data: TensorDict, far: float = 1.0) -> TensorDict:
    """With all that the penalties read; no model predicts next states that lie a thousand times too far."""
    data["demonstrator_action"] = 0.5 * data["action"]
    data["next"].update(
        {
            "observation": far * data["observation"].roll(1, 0),
            "reward": data["observation"][:, :1],
            "terminated": data["next", "collided"],
        }
    )
    return data


def prepared(make: Callable[[], ActorCriticLoss]) -> ActorCriticLoss:
    """A loss whose penalties have seen enough for their terms to count."""
    torch.manual_seed(0)
    loss, data = make(), told(episodes(10))
    for _ in range(8):
        loss.observe(data)
        for penalty in loss.penalties:
            if isinstance(penalty, LifeGuard):
                penalty.fit(sampler(data), 20, penalty.make_optimizer())
    return loss


def outcome(forward: Callable[[TensorDict], TensorDict], loss: ActorCriticLoss, far: float) -> dict[str, torch.Tensor]:
    """The losses of one batch and all gradients of their sum."""
    torch.manual_seed(1)
    losses = forward(told(episodes(3), far))
    loss.zero_grad()
    sum(value for name, value in losses.items() if name.startswith("loss_")).backward()
    gradients = {name: value.grad for name, value in loss.named_parameters() if value.grad is not None}
    return {name: losses[name].detach() for name in loss.out_keys if name.startswith("loss_")} | gradients


@pytest.mark.parametrize("name", LOSSES)
def test_a_loss_is_one_graph(name: str) -> None:
    """With FORK's gate closed, opened by the batch, and closed again."""
    loss = prepared(LOSSES[name])
    other = copy.deepcopy(loss)
    torch._dynamo.reset()
    torch._dynamo.utils.counters.clear()
    assert other.in_keys  # which TorchRL's losses work out when first asked, after which they are compiled once more
    compiled = torch.compile(other, backend="eager", fullgraph=True)
    for far in (1000.0, 1.0, 1000.0):
        torch.testing.assert_close(outcome(compiled, other, far), outcome(loss, loss, far))
        gates = [each.active for each in loss.penalties]
        assert gates == [each.active for each in other.penalties] == [is_open(each, far) for each in loss.penalties]
        assert other.diagnostics() == pytest.approx(loss.diagnostics(), nan_ok=True)
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] == 1


def is_open(penalty: ActorPenalty, far: float) -> bool:
    return far == 1.0 or not isinstance(penalty, Fork)


def test_a_system_network_that_diverged_harms_no_actor_while_the_gate_is_closed() -> None:
    """Its loss is NaN, which closes the gate; no gradient is."""
    loss = fork(td3())
    for parameter in loss.system_network_params.values(True, True):
        parameter.data.fill_(float("nan"))
    actor_loss = torch.compile(loss.actor_loss, backend="eager", fullgraph=True)
    loss.update_gate(float("nan"))
    value, _ = actor_loss(told(episodes(1)))
    value.backward()
    assert value.isfinite()
    assert all(p.grad.isfinite().all() for p in loss.actor_network_params.values(True, True))
