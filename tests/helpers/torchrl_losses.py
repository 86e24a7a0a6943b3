"""TorchRL's own actor–critic losses, small, and what penalties around them read."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torchrl.objectives import CrossQLoss, DDPGLoss, LossModule, REDQLoss, SACLoss, TD3Loss

from tests.helpers.losses import (
    SPEC,
    actor,
    critics,
    episodes,
    fork,
    lifeguard,
    sampler,
    stochastic_actor,
)  # fmt: skip
from uavrl.losses import ActionRate, ActorPenalty, Imitation, LifeGuard


class OthersTD3Loss(TD3Loss):
    """Somebody's subclass, whose actor's loss has a term of its own."""

    def actor_loss(self, tensordict):  # type: ignore[no-untyped-def]
        loss, metadata = super().actor_loss(tensordict)
        return loss + 0.1 * sum(p.square().sum() for p in self.actor_network_params.values(True, True)), metadata


BASES: dict[str, Callable[..., LossModule]] = {
    "td3": lambda **options: TD3Loss(actor(), critics(), action_spec=SPEC, **options),
    "ddpg": lambda **options: DDPGLoss(actor(), critics()[0], delay_actor=True, **options),
    "sac": lambda **options: SACLoss(stochastic_actor(), critics(), action_spec=SPEC, **options),
    "redq": lambda **options: REDQLoss(stochastic_actor(), critics(), num_qvalue_nets=2, action_spec=SPEC, **options),
    "crossq": lambda **options: CrossQLoss(stochastic_actor(), critics(), action_spec=SPEC, **options),
    "a subclass of td3": lambda **options: OthersTD3Loss(actor(), critics(), action_spec=SPEC, **options),
}

PENALTIES: dict[str, Callable[[LossModule], ActorPenalty]] = {
    "fork": fork,
    "lifeguard": lambda base: lifeguard(base, model="mlp", model_lr=1e-2),
    "imitation": lambda base: Imitation(base, limit=2.0),
    "action rate": lambda base: ActionRate(base, actions=2, limit=2.0),
}


def activated(loss: ActorPenalty) -> ActorPenalty:
    """The loss once all its terms count."""
    data = episodes(10)
    data["next"].update({"observation": data["observation"], "reward": torch.ones(len(data), 1)})
    for _ in range(8):
        loss.observe(data)
        for penalty in loss.penalties:
            if isinstance(penalty, LifeGuard):
                penalty.fit(sampler(data), 20, penalty.make_optimizer())
    for penalty in loss.penalties:
        if hasattr(type(penalty), "update_gate"):
            penalty.threshold = 1e9
            penalty.update_gate(0.0)
    assert all(penalty.active for penalty in loss.penalties)
    loss.zero_grad()
    return loss
