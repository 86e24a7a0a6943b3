"""The data set of a run to be given away: its transitions, which TorchRL reads without uavrl, and what they mean."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf
from tensordict import NestedKey, TensorDictBase
from torchrl.data import LazyMemmapStorage

from uavrl.buffers.sequences import EPISODE
from uavrl.config import TrainConfig, validate
from uavrl.envs.privileged import QUANTITIES
from uavrl.errors import UavrlError
from uavrl.export.export import contract
from uavrl.export.recorded import DATA, FORMAT, STORAGE, VERSION, Recorded, read_recorded
from uavrl.runs.directions import with_name_alone
from uavrl.runs.provenance import recorded_versions, versions
from uavrl.transforms.demonstrator import DEMONSTRATOR_ACTION
from uavrl.transforms.privileged import PRIVILEGED
from uavrl_onboard.files import naming, replacing, require_room

# What the contract of a policy says about its inputs and its actions, and what the configuration says about a flight.
TERMS = {"rate_hz", "moment", "cloud", "cells", "pose", "observation", "scaling", "state", "action", "motion"}
SETTINGS = ("env", "perception", "reward", "demonstrator", "backward_reward", "guards", "seed", "choices")


def require_new(folder: Path) -> None:
    """Raises an error unless the folder is new or empty."""
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise UavrlError(f"{folder} already exists and is not an empty folder: choose another with data=FOLDER.")


def export_data(run: Path, checkpoint: str | None, folder: Path, packages: Iterable[str] = ()) -> dict[str, Any]:
    """Writes the whole episodes in a run's replay buffer to a new folder; returns what its ``data.json`` says.

    ``data.json`` comes last: a folder without it is not whole, and :func:`~uavrl.load_data` refuses it.
    """
    require_new(folder)
    recorded = read_recorded(run, checkpoint)
    recorded.config.packages = list(packages)
    row = recorded[:1]
    about = description(recorded, row, run)
    size = sum(value.nbytes for value in row.values(include_nested=True, leaves_only=True))
    was_there = folder.is_dir()
    try:
        with naming(folder):
            folder.mkdir(parents=True, exist_ok=True)
            require_room(folder, len(recorded) * size + 1_000_000)
            _write(recorded, folder / STORAGE)
            with replacing(folder / DATA) as partial:
                partial.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        if was_there:
            folder.mkdir(exist_ok=True)
        raise
    return about


def _write(recorded: Recorded, folder: Path) -> None:
    """Writes all transitions in the format of TorchRL's storages."""
    storage = LazyMemmapStorage(len(recorded), scratch_dir=folder)
    done = 0
    for part in recorded.parts():
        storage.set(torch.arange(done, done + len(part)), part)
        done += len(part)
    storage.dumps(folder)  # it is there already: this adds what TorchRL needs to load it


def description(recorded: Recorded, row: TensorDictBase, run: Path) -> dict[str, Any]:
    """What ``data.json`` says: what each number is, and where the transitions come from."""
    settings = validate(recorded.config)
    terms = contract(settings, "")
    inputs = {} if terms is None else terms.model_dump(mode="json", include=TERMS, exclude_none=True)
    outcomes = Counter(recorded.outcomes())
    config = OmegaConf.to_container(with_name_alone(recorded.config), resolve=True)
    assert isinstance(config, dict)
    return {
        "format": FORMAT,
        "version": VERSION,
        "transitions": len(recorded),
        "episodes": len(recorded.last),
        "outcomes": {name: outcomes[name] for name in ("arrived", "collided", "timed_out")},
        "keys": {".".join(_path(key)): entry for key, entry in _keys(row, settings, bool(inputs)).items()},
        "policy_inputs": inputs or None,
        "settings": {key: config[key] for key in SETTINGS if key in config},
        "lidar_stride": settings.trainer.lidar_stride,
        "run": run.resolve().name,
        "checkpoint": recorded.path.name,
        "training_steps": recorded.metadata["collected_frames"],
        "commit": recorded.metadata.get("commit"),
        "versions": {"training": recorded_versions(run), "export": versions()},
    }


def _path(key: NestedKey) -> tuple[str, ...]:
    return (key,) if isinstance(key, str) else tuple(key)


def _keys(row: TensorDictBase, settings: TrainConfig, ours: bool) -> dict[NestedKey, dict[str, Any]]:
    """Shape, type, unit and meaning of each entry; ``ours`` says whether actions are velocities and a yaw rate."""
    meanings = _meanings(settings, ours)
    found: dict[NestedKey, dict[str, Any]] = {}
    for key in sorted(row.keys(include_nested=True, leaves_only=True), key=_path):
        value = row.get(key)
        about = {"shape": list(value.shape[1:]), "dtype": str(value.dtype).removeprefix("torch.")}
        found[key] = about | {"meaning": meanings.get(_path(key), "a quantity of the environment")}
    return found


def _read_by_critics(name: str) -> str:
    """What is stored of a quantity that critics read."""
    if (quantity := QUANTITIES.get(name)) is None:
        return f"{name}, as the environment emits it"
    scaled = "" if quantity.divisor == 1.0 else f" divided by {quantity.divisor:g}"
    numbers = f"{len(quantity.signs)} number{'s' * (len(quantity.signs) > 1)}"
    return f"{name}, {numbers} ({quantity.unit}{scaled})"


def _meanings(settings: TrainConfig, ours: bool) -> dict[tuple[str, ...], str]:
    steps, gamma = settings.algo.get("n_steps", 1), settings.algo.get("gamma")
    action = ": forward, left and up in m/s, yaw rate in rad/s; see policy_inputs.action" if ours else ""
    state = "observations, oldest first, scaled; see policy_inputs.observation and state" if ours else "observation"
    several = steps > 1
    later = "`steps_to_next_obs` steps later" if several else "one step later"
    reward = f"sum of the rewards of these steps, discounted by {gamma} per step" if several else "of the step"
    relabelled = settings.backward_reward.get("_target_") is not None
    reads = "; ".join(_read_by_critics(name) for name in settings.algo.get("critic_reads", ()))
    return {
        ("observation",): f"the input of the policy: {state}",
        (
            "action",
        ): f"the action of the policy or demonstrator there, with exploration noise; guards may change it{action}",
        (DEMONSTRATOR_ACTION,): f"the action of the demonstrator there{action}",
        (PRIVILEGED,): f"additional input of the critics, one after the other: {reads}",
        (EPISODE,): "number of the episode, from 0; its transitions are next to each other, in the order of flight",
        ("steps_to_next_obs",): f"steps to the next observation: {steps}, or fewer at the end of an episode",
        ("next", "observation"): f"the same, {later}",
        ("next", PRIVILEGED): f"the same, {later}",
        ("next", "reward"): reward + (", after backward_reward has changed it" if relabelled else ""),
        ("next", "done"): f"whether the episode has ended {later}",
        ("next", "terminated"): f"whether it has ended so {later} that nothing follows, by arrival or collision",
        ("next", "arrived"): f"whether the vehicle has reached the goal {later}",
        ("next", "collided"): f"whether it has collided {later}",
    }
