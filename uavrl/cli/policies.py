"""What evaluation and replay share: whose policy flies, in which environment, and where the result goes."""

from __future__ import annotations

import errno
import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

import uavrl
from uavrl.configs import to_dataclass
from uavrl.errors import UavrlError

if TYPE_CHECKING:
    from uavrl.configs import TrainConfig

PACKAGED = Path(uavrl.__file__).parent / "policies"  # what `policy=NAME` flies, beside the baselines

# Keys of an evaluation that do not tell which tasks were flown by what.
UNTOLD = ("run", "episodes", "output", "device", "threads", "products", "progress")


def with_overrides(run_config: DictConfig, composed: DictConfig, overrides: list[str]) -> DictConfig:
    """The run's configuration with what the command line says about environment and sensor.

    ``env=NAME`` replaces the environment; ``env.key=value``, ``perception.lidar.key=value``, ``perception.blind=value``
    and ``perception.blind_to=value`` change one value. The rest of perception makes the policy's input: it stays.
    """
    result = run_config.copy()
    keys = [override.split("=", 1)[0] for override in overrides]
    if "env" in keys:
        result.env = composed.env
    for key in keys:
        if key.startswith(("env.", "perception.lidar.")) or key in ("perception.blind", "perception.blind_to"):
            OmegaConf.update(result, key, OmegaConf.select(composed, key), merge=False)
        elif key.split(".")[0] in ("perception", "reward"):
            raise UavrlError(f"{key} belongs to the run and cannot change when its policy flies: leave it out.")
    return result


def told_apart(overrides: Sequence[str], plain: Collection[str]) -> list[str]:
    """The overrides of a command line whose keys are not plain: those that tell its result from another one."""
    return [override for override in overrides if override.split("=")[0] not in plain]


def name_of_output(stem: str, overrides: Sequence[str]) -> str:
    """A file name without suffix in which the overrides stand.

    Examples:
        >>> name_of_output("evaluation", ["valleys=[100,101]"])
        'evaluation_valleys=100-101'
    """
    told = [re.sub(r"[^\w.=-]+", "-", override).replace("=-", "=").strip("-") for override in overrides]
    return "_".join([stem, *told])


def writable(output: Path, key: str = "output") -> Path:
    """The path itself, found writable before anything is flown; its folder is made.

    Raises:
        UavrlError: when it cannot be written; ``key`` names the setting that chooses another.
    """
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        if output.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        partial = output.with_name(output.name + ".partial")
        partial.unlink(missing_ok=True)  # it may be a link to somewhere else
        partial.touch()
        partial.unlink()
    except OSError as error:
        raise UavrlError(f"{output} cannot be written ({error.strerror}): choose another with {key}=FILE.") from error
    return output


def packaged_policies() -> list[str]:
    """The names of the policies that come with the package.

    Examples:
        >>> "static" in packaged_policies()
        True
    """
    return sorted(path.parent.name for path in PACKAGED.glob("*/policy.json"))


def policy_folder(run: str | None, policy: str | None) -> Path | None:
    """Where the policy lies that the command line names: a run, or a packaged policy; None for a baseline.

    Raises:
        UavrlError: unless exactly one of the two is given.
    """
    if (run is None) == (policy is None):
        raise UavrlError("Give either run=RUN_FOLDER or policy=NAME, and not both.")
    if run is not None:
        return Path(run)
    return PACKAGED / str(policy) if policy in packaged_policies() else None


def load_policy(run_dir: Path, checkpoint: str | None, device: Any) -> tuple[DictConfig, Any, dict[str, Any]]:
    """The policy of a run or of a folder that ``uavrl-export`` wrote, ready to fly.

    Returns:
        The run's configuration, the policy, and what a result says about them.

    Raises:
        UavrlError: when the run or the checkpoint is missing or damaged.
    """
    config, actor, about = load_actor(run_dir, checkpoint, device)

    def policy(tensordict: Any) -> Any:
        acted = actor(tensordict.select("observation").to(device))
        return tensordict.set("action", acted["action"].to(tensordict["observation"].device))

    told = ("checkpoint", "training_steps", "training_episodes", "commit")
    return config, policy, {"run": str(run_dir), **{key: about[key] for key in told if key in about}}


def load_actor(run_dir: Path, checkpoint: str | None, device: Any) -> tuple[DictConfig, Any, dict[str, Any]]:
    """The policy's module, from the checkpoint named, else from a policy on its own, else from the newest checkpoint.

    Returns:
        The run's configuration, the module, and where it comes from.

    Raises:
        UavrlError: when the run or the checkpoint is missing or damaged.
    """
    from torchrl.checkpoint import Checkpoint

    from uavrl.training.checkpoint import check_checkpoint, read_config, restore
    from uavrl.training.exported import is_exported, load_exported
    from uavrl.training.learner import make_actor
    from uavrl.training.spaces import make_spaces

    config = read_config(run_dir)
    train_config: TrainConfig = to_dataclass(config)
    actor = make_actor(train_config.algo, make_spaces(train_config.env, train_config.perception), device)
    if checkpoint is None and is_exported(run_dir):
        return config, actor, load_exported(run_dir, actor)
    path = checkpoint_path(run_dir, checkpoint)
    metadata = check_checkpoint(path, config)
    restore(Checkpoint(policy=actor), path, ["policy"])
    about = {
        "checkpoint": path.name,
        "training_steps": metadata["collected_frames"],
        "training_episodes": metadata["episodes"],
        "commit": metadata.get("commit"),
    }
    return config, actor, about


def checkpoint_path(run_dir: Path, checkpoint: str | None) -> Path:
    """The file of the checkpoint named, or of the run's newest.

    Raises:
        UavrlError: when there is none.
    """
    from uavrl.training.checkpoint import latest_checkpoint

    path = Path(checkpoint) if checkpoint else latest_checkpoint(run_dir)
    if not path.is_file():
        raise UavrlError(f"Expected a checkpoint at {path} and found none: leave checkpoint out to take the newest.")
    return path


def baseline(name: str, flight_level: float) -> Any:
    """A policy that learns nothing, by its name.

    Raises:
        UavrlError: for an unknown name.
    """
    from uavrl.training.baselines import BASELINES

    if name not in BASELINES:
        names = ", ".join([*BASELINES, *packaged_policies()])
        raise UavrlError(f"policy must be one of {names}, got {name!r}: to fly your own give run=RUN_FOLDER.")
    return BASELINES[name](flight_level)
