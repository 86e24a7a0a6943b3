"""The policy of a run, and its loss with enhancers."""

from typing import Any, Literal

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn

from uavrl.config.build import build, find_class, options
from uavrl.config.context import CONTEXT, refuse_context
from uavrl.config.sentences import require
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss, Enhancer
from uavrl.training.guided import GUIDE_ACTION
from uavrl.training.network_sizes import NetworkSizes


def make_actor(settings: TrainConfig, sizes: NetworkSizes, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """The policy: reads ``observation``, writes ``action``; the loss says what its network gives."""
    network = _network("actor", settings, sizes).to(device)
    return _loss_class(settings).policy_of(network, sizes.action_spec(device))


def make_loss(
    settings: TrainConfig, actor: TensorDictModuleBase, sizes: NetworkSizes, device: torch.device
) -> ActorCriticLoss:
    """The loss of the algorithm with critics of its own, and the enhancers around it: FORK first, LifeGuard next."""
    loss_class, packages = _loss_class(settings), settings.packages
    critics = [
        TensorDictModule(
            _network("critic", settings, sizes).to(device),
            in_keys=["observation", "action"],
            out_keys=["state_action_value"],
        )
        for _ in range(loss_class.num_critics)
    ]
    written = options(settings.algo, packages, **_context(sizes))
    refuse_context("algo", written, CONTEXT["algo"])
    loss = loss_class.of_networks(actor, critics, sizes.action_spec(device), **written)
    given = {"gamma": settings.algo.gamma, **_context(sizes)}
    for part in (settings.fork, settings.lifeguard, settings.enhancer):
        enhanced = build(part, Enhancer, packages=packages, base=loss, **given)  # type: ignore[type-abstract]
        if enhanced is None:
            continue
        steps = settings.algo.get("n_steps", 1)
        single = enhanced.learns_from_single_steps
        require(steps == 1 or not single, "algo.n_steps", f"1: {part._target_} learns from single steps", steps)
        told = settings.guided or GUIDE_ACTION not in enhanced.in_keys
        require(told, "guide", f"a guide's name, such as vfh: {part._target_} learns what it would do", None)
        loss = enhanced
    return loss.to(device)


def _loss_class(settings: TrainConfig) -> type[ActorCriticLoss]:
    name = str(settings.algo._target_)
    return find_class(name, ActorCriticLoss, settings.packages)  # type: ignore[type-abstract]


def _network(role: Literal["actor", "critic"], settings: TrainConfig, sizes: NetworkSizes) -> nn.Module:
    """The network of a part of ``algo``, tried once: what takes other inputs would fail in the middle of a flight."""
    part = getattr(settings.algo, role)
    network = build(part, nn.Module, packages=settings.packages, **_context(sizes))
    if network is None:
        raise UavrlError(f"algo.{role} must name a network, got null: choose another algorithm.")
    inputs = [torch.zeros(2, sizes.state)] + [torch.zeros(2, sizes.actions)] * (role == "critic")
    training = network.training
    try:
        with torch.no_grad(), torch.random.fork_rng(devices=[]):
            network.eval()(*inputs)
    except Exception as error:
        takes = {"actor": "an observation", "critic": "an observation and an action"}[role]
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UavrlError(
            f"algo.{role} must be a network that takes {takes}, and {part._target_} does not ({reason}): name another."
        ) from error
    finally:
        network.train(training)
    return network


def _context(sizes: NetworkSizes) -> dict[str, Any]:
    return {"observations": sizes.state, "actions": sizes.actions, "limit": sizes.limit, "stacked": sizes.frames}
