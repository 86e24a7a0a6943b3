"""The policy of a configuration."""

from typing import Any, Literal

import torch
from tensordict.nn import TensorDictModuleBase
from torch import nn

from uavrl.config.build import build, find_class
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss
from uavrl.rollout.environment import NetworkSizes


def make_actor(settings: TrainConfig, sizes: NetworkSizes, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """The policy: reads ``observation``, writes ``action``; the loss says what its network gives."""
    network = make_network("actor", settings, sizes).to(device)
    return loss_class(settings).policy_of(network, sizes.action_spec(device))


def loss_class(settings: TrainConfig) -> type[ActorCriticLoss]:
    """The class of the algorithm's loss."""
    name = str(settings.algo._target_)
    return find_class(name, ActorCriticLoss, settings.packages)


def make_network(role: Literal["actor", "critic"], settings: TrainConfig, sizes: NetworkSizes) -> nn.Module:
    """The network of a part of ``algo``, tried once: what takes other inputs would fail in the middle of a flight."""
    part = getattr(settings.algo, role)
    network = build(part, nn.Module, packages=settings.packages, **network_context(sizes))
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


def network_context(sizes: NetworkSizes) -> dict[str, Any]:
    """What a run hands to the networks that name it."""
    return {"observations": sizes.state, "actions": sizes.actions, "limit": sizes.limit, "stacked": sizes.frames}
