"""What an evaluation depends on, as one hash: its configuration and the contents of the files that this names."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from uavrl.config import EvaluateConfig
from uavrl.envs.sensors import sensor_settings
from uavrl.evaluation.policies import file_of_policy, folder_of_policy, policy_folder
from uavrl.runs.checkpoint import checkpoint_path
from uavrl.runs.directions import DIRECTIONS
from uavrl.runs.names import CONFIG
from uavrl.runs.provenance import versions
from uavrl.runs.weights import POLICY
from uavrl_onboard.policy.contract import CONTRACT, NETWORK

_OF_A_POLICY = (POLICY.json, POLICY.safetensors, CONFIG, CONTRACT, NETWORK, *DIRECTIONS)
_PLACES = (
    *("run", "output", "progress", "suite", "processes", "threads", "device", "checkpoint", "hydra"),
    *("packages", "matmul", "vecnormalize"),
)
"""Keys that change no result, or name a file whose content counts instead."""


def inputs_digest(config: DictConfig, settings: EvaluateConfig) -> str:
    """A hash of what the result of an evaluation depends on.

    The code of parts of one's own is not in it, but for the file of a policy's class, nor are the machine and the
    libraries.

    Args:
        config: of ``conf/evaluate.yaml``, composed.
        settings: the same, validated; of any scenario of the suite.
    """
    plain = OmegaConf.to_container(config, resolve=False)
    assert isinstance(plain, dict)
    told = {str(key): value for key, value in plain.items() if key not in _PLACES}
    folder = None if settings.policy is None else folder_of_policy(settings.policy)
    if folder is not None:
        del told["policy"]
    parts: list[Any] = [versions()["uavrl"], told, _lidar(told)]
    parts += [_digest(path) for path in _files(settings, folder)]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def _lidar(told: dict[str, Any]) -> Any:
    """The settings of the user's own LiDAR, with a hash of its directions."""
    env = told.get("env")
    settings = sensor_settings(env.get("lidar") if isinstance(env, dict) else None)
    if not isinstance(settings, dict) or not isinstance(settings.get("directions"), str):
        return settings
    return {**settings, "directions": _digest(Path(settings["directions"]))}


def _files(settings: EvaluateConfig, exported: Path | None) -> list[Path]:
    """The files that the policy comes from; ``exported`` is the folder that ``policy`` names."""
    if exported is not None:
        return [exported / name for name in _OF_A_POLICY]
    folder = policy_folder(settings.run, settings.policy)
    if folder is not None:
        if settings.checkpoint is None and POLICY.is_in(folder):
            return [folder / name for name in _OF_A_POLICY]
        return [folder / CONFIG, checkpoint_path(folder, settings.checkpoint)]
    file = file_of_policy(str(settings.policy), settings.packages)
    extra = [] if settings.vecnormalize is None else [Path(settings.vecnormalize)]
    return extra if file is None else [file, *extra]


def _digest(path: Path) -> str | None:
    """A hash of a file's content; of a checkpoint, an archive, of the checksums that it holds. None without a file."""
    if not path.is_file():
        return None
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return repr([(entry.filename, entry.CRC, entry.file_size) for entry in archive.infolist()])
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
