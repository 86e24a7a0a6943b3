"""The policy of a run or of a folder of its own, loaded."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase
from torchrl.checkpoint import Checkpoint

from uavrl.config import validate
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.loaded import LoadedPolicy
from uavrl.losses.networks import NetworkSizes, make_actor, network_sizes
from uavrl.runs.checkpoint import check_checkpoint, checkpoint_path, restore
from uavrl.runs.config import read_config
from uavrl.runs.names import CONFIG
from uavrl.runs.provenance import recorded_versions
from uavrl.runs.weights import POLICY

POLICY_INFO = ("checkpoint", "training_steps", "training_episodes", "commit")  # about a policy, beside a result


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


def saved_sizes(settings: TrainConfig) -> NetworkSizes:
    """What the networks of a run read and write, asked of its environment."""
    parts, critic_reads = (settings.env, settings.perception), settings.algo.get("critic_reads", ())
    env = make_env(*parts, packages=settings.packages, num_uavs=1, critic_reads=critic_reads)
    try:
        return network_sizes(env)
    finally:
        env.close()
