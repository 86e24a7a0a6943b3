"""The policy of a configuration: made new, or loaded from a run or a folder of its own."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import torch
from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.checkpoint import Checkpoint

from uavrl.config import validate
from uavrl.config.build import build, find_class
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import NetworkSizes, make_env, network_sizes
from uavrl.evaluation.loaded import LoadedPolicy
from uavrl.losses import ActorCriticLoss
from uavrl.models.memory import MEMORY, GRUMemory, RecurrentPolicy
from uavrl.runs.checkpoint import check_checkpoint, latest_checkpoint, restore
from uavrl.runs.config import read_config
from uavrl.runs.names import CONFIG
from uavrl.runs.provenance import recorded_versions
from uavrl.runs.weights import POLICY
from uavrl_onboard.sentences import require

POLICY_INFO = ("checkpoint", "training_steps", "training_episodes", "commit")  # about a policy, beside a result


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


def load_actor(
    folder: Path, checkpoint: str | None, device: torch.device | str, packages: Iterable[str] = ()
) -> tuple[DictConfig, TensorDictModuleBase, dict[str, Any]]:
    """Configuration, policy and origin: of the checkpoint named, else of a policy on its own, else the newest."""
    config = read_config(folder)
    config.packages = list(packages)
    settings = validate(config)
    sizes = saved_sizes(settings)
    actor = make_actor(settings, sizes, device).to(torch.float32)  # as it was saved, whatever the host's default is
    if checkpoint is None and POLICY.is_in(folder):
        about, weights = POLICY.load(folder)
        try:
            actor.load_state_dict(weights)
        except RuntimeError as error:
            other = f"The weights in {folder} are of another policy than its {CONFIG} describes"
            raise UavrlError(f"{other}: {POLICY.remedy}.") from error
        return config, actor, {**about, "inputs": sizes.state}
    path = checkpoint_path(folder, checkpoint)
    metadata = check_checkpoint(path, config)
    restore(Checkpoint(policy=actor), path, ["policy"])
    steps, episodes = metadata["collected_frames"], metadata["episodes"]
    about = dict(zip(POLICY_INFO, (path.name, steps, episodes, metadata.get("commit")), strict=True))
    return config, actor, {**about, "inputs": sizes.state, "versions": recorded_versions(folder)}


def read_policy(
    folder: Path, checkpoint: str | None = None, device: torch.device | str = "cpu", packages: Iterable[str] = ()
) -> LoadedPolicy:
    """What :func:`load_actor` loads, as a policy of an environment on the CPU."""
    config, actor, about = load_actor(folder, checkpoint, device, packages)
    source = {"run": str(folder), **{key: about[key] for key in POLICY_INFO if key in about}}
    return LoadedPolicy(actor, config, source, inputs=about["inputs"])


def checkpoint_path(run_dir: Path, checkpoint: str | None) -> Path:
    """The file of the checkpoint named, or of the run's newest."""
    path = Path(checkpoint) if checkpoint else latest_checkpoint(run_dir)
    if not path.is_file():
        raise UavrlError(f"Expected a checkpoint at {path} and found none: leave checkpoint out to take the newest.")
    return path


def saved_sizes(settings: TrainConfig) -> NetworkSizes:
    """What the networks of a run read and write, asked of its environment."""
    parts, critic_reads = (settings.env, settings.perception), settings.algo.get("critic_reads", ())
    env = make_env(*parts, packages=settings.packages, num_uavs=1, critic_reads=critic_reads)
    try:
        return network_sizes(env)
    finally:
        env.close()
