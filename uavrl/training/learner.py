"""The policy of a run, and its loss with enhancers."""

from __future__ import annotations

from typing import Any

import torch
from omegaconf import DictConfig
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn

from uavrl.configs.build import build, options, resolve
from uavrl.configs.train import TrainConfig
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss, Enhancer
from uavrl.training.spaces import Spaces


def make_actor(settings: TrainConfig, spaces: Spaces, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """The policy: reads ``observation``, writes ``action``; the loss says what its network gives."""
    network = _network(settings.algo.actor, settings, spaces).to(device)
    return _loss_class(settings).policy_of(network, spaces.action_spec(device))


def make_loss(
    settings: TrainConfig, actor: TensorDictModuleBase, spaces: Spaces, device: torch.device
) -> ActorCriticLoss:
    """The loss of the algorithm with critics of its own, and the enhancers around it: FORK first, LifeGuard next."""
    loss_class, packages = _loss_class(settings), settings.packages
    critics = [
        TensorDictModule(
            _network(settings.algo.critic, settings, spaces).to(device),
            in_keys=["observation", "action"],
            out_keys=["state_action_value"],
        )
        for _ in range(loss_class.num_critics)
    ]
    loss = loss_class.of_networks(actor, critics, spaces.action_spec(device), **options(settings.algo, packages))
    given = {"gamma": settings.algo.gamma, "stacked": spaces.frames, **_widths(spaces)}
    for part in (settings.fork, settings.lifeguard, settings.enhancer):
        enhanced = build(part, Enhancer, packages=packages, base=loss, **given)  # type: ignore[type-abstract]
        loss = loss if enhanced is None else enhanced
    return loss.to(device)


def _loss_class(settings: TrainConfig) -> type[ActorCriticLoss]:
    name = str(settings.algo._target_)
    return resolve(name, ActorCriticLoss, settings.packages)  # type: ignore[type-abstract]


def _network(part: DictConfig, settings: TrainConfig, spaces: Spaces) -> nn.Module:
    network = build(part, nn.Module, packages=settings.packages, limit=spaces.limit, **_widths(spaces))
    if network is None:
        raise UavrlError("algo.actor and algo.critic must name a network, got null: choose another algorithm.")
    return network


def _widths(spaces: Spaces) -> dict[str, Any]:
    return {"observations": spaces.state, "actions": spaces.actions}
