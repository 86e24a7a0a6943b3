"""Policies on their own: the weights of a run's policy with its configuration, without optimisers and replay buffer."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModuleBase

from uavrl.errors import UavrlError
from uavrl.files import replacing
from uavrl.training.checkpoint import CONFIG

FORMAT = "uavrl.policy"
VERSION = 1
ABOUT, WEIGHTS = "policy.json", "policy.safetensors"


def is_exported(folder: Path) -> bool:
    """Whether a folder holds a policy on its own."""
    return (folder / ABOUT).is_file()


def export_policy(actor: TensorDictModuleBase, config: DictConfig, about: dict[str, Any], output: Path) -> None:
    """Writes ``policy.safetensors``, ``config.yaml`` and then ``policy.json``, without which nothing loads.

    Args:
        actor: the policy.
        config: the run's configuration; where its run lay is left out.
        about: what else ``policy.json`` tells: run, steps, commit.
        output: the folder, made if need be.

    Raises:
        UavrlError: when the folder holds a policy or a run, or cannot be written.
    """
    from safetensors.torch import save

    if any((output / name).exists() for name in (ABOUT, CONFIG)):
        raise UavrlError(f"The folder {output} holds a policy or a run already: choose another with --output FOLDER.")
    weights = {name: tensor.detach().cpu().contiguous() for name, tensor in actor.state_dict().items()}
    content = save(weights)
    facts = {
        "format": FORMAT,
        "version": VERSION,
        "shapes": {name: list(tensor.shape) for name, tensor in weights.items()},
        "weights_sha256": hashlib.sha256(content).hexdigest(),
        **about,
    }
    config = config.copy()
    config.run_dir = Path(str(config.run_dir)).name
    try:
        output.mkdir(parents=True, exist_ok=True)
        (output / WEIGHTS).write_bytes(content)
        with replacing(output / ABOUT) as about_partial, replacing(output / CONFIG) as config_partial:
            about_partial.write_text(json.dumps(facts, indent=1) + "\n")
            config_partial.write_text(OmegaConf.to_yaml(config))
    except OSError as error:
        raise UavrlError(
            f"{output} cannot be written ({error.strerror}): choose another with --output FOLDER."
        ) from error


def load_exported(folder: Path, actor: TensorDictModuleBase) -> dict[str, Any]:
    """Puts exported weights into a policy of the same shape.

    Returns:
        What ``policy.json`` holds.

    Raises:
        UavrlError: when a file is missing, damaged, or of another policy.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    try:
        about = json.loads((folder / ABOUT).read_text())
        content = (folder / WEIGHTS).read_bytes()
        known = (about["format"], about["version"]) == (FORMAT, VERSION)
        digest = about["weights_sha256"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UavrlError(f"Expected an exported policy in {folder}, and it cannot be read ({error}).") from error
    if not known:
        raise UavrlError(f"{folder / ABOUT} is not a policy that this version of uavrl reads: export it again.")
    if hashlib.sha256(content).hexdigest() != digest:
        raise UavrlError(f"{folder / WEIGHTS} is damaged (its checksum differs from {ABOUT}'s): export it again.")
    try:
        actor.load_state_dict(load(content))
    except (RuntimeError, SafetensorError) as error:
        raise UavrlError(
            f"The weights in {folder} are of another policy than its {CONFIG} describes: export it again."
        ) from error
    return about
