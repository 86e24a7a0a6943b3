"""The networks of a run: their sizes, and those of its policy and its critics."""

from dataclasses import dataclass
from typing import Any, Literal

import torch
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.data import Bounded
from torchrl.envs import CatFrames, EnvBase

from uavrl.config.build import build, find_class
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.models.memory import MEMORY, GRUMemory, RecurrentPolicy
from uavrl.transforms.composition import inner_transforms
from uavrl.transforms.privileged import PRIVILEGED
from uavrl_onboard.sentences import require


@dataclass(frozen=True)
class NetworkSizes:
    """Widths of state and action."""

    state: int  # numbers in the policy's state
    frames: int  # observations in a state
    actions: int  # numbers in an action
    limit: float  # the largest action; the smallest is its negative
    privileged: int = 0  # numbers that the critics read beside the state

    def action_spec(self, device: torch.device | str) -> Bounded:
        """The bounds of one action."""
        return Bounded(-self.limit, self.limit, (self.actions,), device=device, dtype=torch.float32)


def network_sizes(env: EnvBase) -> NetworkSizes:
    """The sizes of an environment with its transforms."""
    spec = env.action_spec_unbatched
    limit = float(spec.high.max()) if isinstance(spec, Bounded) else 0.0
    if not isinstance(spec, Bounded) or not bool((spec.high == limit).all() and (spec.low == -limit).all()):
        raise UavrlError(f"Expected actions in [-a, a], got {spec}: scale them by a transform.")
    stacks = [t.N for t in inner_transforms(getattr(env, "transform", None)) if isinstance(t, CatFrames)]
    width = int(env.observation_spec["observation"].shape[-1])
    privileged = env.observation_spec.get(PRIVILEGED, None)
    more = 0 if privileged is None else int(privileged.shape[-1])
    return NetworkSizes(width, stacks[-1] if stacks else 1, int(spec.shape[-1]), limit, more)


def make_actor(settings: TrainConfig, sizes: NetworkSizes, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """The policy: reads ``observation``, writes ``action``; the loss says what its network gives."""
    kind, memory = loss_class(settings), make_memory(settings, sizes)
    if memory is None:
        return kind.policy_of(make_network("actor", settings, sizes).to(device), sizes.action_spec(device))
    require(kind.critics_may_differ, "algo", "td3 or sac with a memory: choose one of them", settings.algo["_target_"])
    network = make_network("actor", settings, sizes, memory.size).to(device)
    head = kind.policy_of(network, sizes.action_spec(device), in_keys=(MEMORY, "observation"))
    return RecurrentPolicy(memory.to(device), head)


def make_memory(settings: TrainConfig, sizes: NetworkSizes) -> GRUMemory | None:
    """A memory of the observations, None without one."""
    return build(settings.recurrent, GRUMemory, packages=settings.packages, key="recurrent", observations=sizes.state)


def recurrent_shape(settings: TrainConfig) -> tuple[int, int] | None:
    """The shape of the state that the policy carries from step to step, None without a memory."""
    return None if settings.recurrent.get("_target_") is None else (1, settings.recurrent.size)


def loss_class(settings: TrainConfig) -> type[ActorCriticLoss]:
    """The class of the algorithm's loss."""
    name = str(settings.algo._target_)
    return find_class(name, ActorCriticLoss, settings.packages)


def make_network(role: Literal["actor", "critic"], settings: TrainConfig, sizes: NetworkSizes, *more: int) -> nn.Module:
    """The network of a part of ``algo``, tried once: what takes other inputs would fail in the middle of a rollout.

    It takes the parts of a state, of which ``more`` are the widths beside that of the observation.
    """
    part = getattr(settings.algo, role)
    taken = {**network_context(sizes), "observations": sum(more) + sizes.state}
    network = build(part, nn.Module, packages=settings.packages, **taken)
    if network is None:
        raise UavrlError(f"algo.{role} must name a network, got null: choose another algorithm.")
    widths = [*more, sizes.state] + [sizes.actions] * (role == "critic")
    inputs = [torch.zeros(2, width) for width in widths]
    training = network.training
    try:
        with torch.no_grad(), torch.random.fork_rng(devices=[]):
            network.eval()(*inputs)
    except Exception as error:
        takes = {"actor": "an observation", "critic": "an observation and an action"}[role]
        takes = f"{'one tensor more and ' if more else ''}{takes}"
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
