"""Reads run folders: each gives a :class:`Run`, or the name of its broken file."""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import OmegaConf

from uavrl.config import learner_name
from uavrl.config.parts import PARTS
from uavrl.config.yaml_files import NONE
from uavrl.errors import OtherFormat, UavrlError
from uavrl.evaluation.worlds import seed_ranges
from uavrl.runs import names
from uavrl.runs.config import load_config
from uavrl.runs.directions import by_content, use_kept_directions
from uavrl.runs.episodes import RATES, Episode, read_episodes, wilson
from uavrl.runs.names import CONFIG, EPISODES
from uavrl.runs.weights import ARTIFACT, POLICY
from uavrl_onboard.pluralize import pluralize

_DEPTH = 4  # of folders that are searched for runs
_MOST_STEPS = 2**53  # above, the doubles of JavaScript skip integers
_COPIED = ("policy", "training_steps", "path_efficiency", "median_clearance", "steps_per_arrival")
T = TypeVar("T")


class NoEpisodes(UavrlError):
    """A run ended, or was asked for, before its first episode was over."""


@dataclass(frozen=True)
class Run:
    """One run folder.

    Attributes:
        name: in a report.
        config: its configuration as its file has it.
        settings: its values by their dotted names (see :func:`flatten`).
        choices: the yaml file of each part, by the part's name.
        seed: of the run.
        episodes: at least one.
        versions: of uavrl and torch, and the commit, where the run has ended and recorded them.
        ended_with: episodes that it had when it ended last.
        evaluations: the files of ``uavrl-evaluate`` in the folder, each with its ``file``, without single episodes.
        class_sizes: of the trajectory classes, where the folder holds their artifact.
        notes: faults that do not keep it from being reported.
    """

    name: str
    config: dict[str, Any]
    settings: dict[str, Any]
    choices: dict[str, str]
    seed: int
    episodes: list[Episode]
    versions: dict[str, Any] = field(default_factory=dict)
    ended_with: int | None = None
    evaluations: list[dict[str, Any]] = field(default_factory=list)
    class_sizes: dict[str, Any] | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def finished(self) -> bool:
        """Whether it has reached its number of episodes or of steps, or says that it has ended with these episodes."""
        trainer = self.config["trainer"]
        limits, reached = (trainer["episodes"], trainer.get("steps")), (len(self.episodes), self.steps)
        flown = any(limit is not None and value >= limit for value, limit in zip(reached, limits, strict=True))
        return flown or self.ended_with == len(self.episodes)

    @property
    def steps(self) -> int:
        """Environment steps of all its episodes."""
        return self.episodes[-1].total_steps


@dataclass(frozen=True)
class LeftOut:
    """A folder that is not reported, by its name, and what to do about it."""

    folder: str
    reason: str


def flatten(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The values of a nested mapping by dotted names; ``None`` and empty mappings are left out."""
    flat: dict[str, Any] = {}
    for key, value in node.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        elif value is not None:
            flat[f"{prefix}{key}"] = list(value) if isinstance(value, tuple) else value
    return flat


def read_runs(folders: Sequence[Path]) -> tuple[list[Run], list[LeftOut]]:
    """Reads all runs in and below ``folders``, each once."""
    inside = {folder: list(_run_folders(folder.resolve())) for folder in folders}
    give = "pass the folder that uavrl-train printed."
    none = {True: f"It contains no runs: {give}", False: f"There is no such folder: {give}"}
    left_out = [LeftOut(str(folder), none[folder.exists()]) for folder, runs in inside.items() if not runs]
    found = dict.fromkeys(run for runs in inside.values() for run in runs)
    names = [folder.name for folder in found]
    runs = []
    for folder in found:
        name = folder.name if names.count(folder.name) == 1 else f"{folder.parent.name}/{folder.name}"
        try:
            runs.append(read_run(folder, name))
        except UavrlError as error:
            left_out.append(LeftOut(name, str(error)))
    return runs, left_out


def _run_folders(folder: Path) -> Iterator[Path]:
    """Folders that hold a run's files; nothing below one, nothing hidden and nothing deep down is searched."""
    for path, children, files in os.walk(folder):
        depth = len(Path(path).relative_to(folder).parts)
        if {CONFIG, EPISODES} & set(files):
            children.clear()
            yield Path(path)
        children[:] = sorted(name for name in children if name[0] != "." and depth < _DEPTH)


def read_run(folder: Path, name: str) -> Run:
    """Reads one run folder."""
    if POLICY.is_in(folder):
        raise UavrlError("It is an exported policy, which has no training to report: give the folder of its run.")
    config = _read(folder / CONFIG, _config)
    choices = {str(group): str(choice) for group, choice in config["choices"].items()}
    notes: list[str] = []
    versions, ended_with = _optional(folder / "summary.json", _summary, notes) or ({}, None)
    return Run(
        name=name,
        config=config,
        settings=_settings(config, choices),
        choices=choices,
        seed=config["seed"],
        episodes=_read(folder / EPISODES, _episodes),
        versions=versions,
        ended_with=ended_with,
        evaluations=[
            row for path in sorted(folder.glob("evaluation*.json")) if (row := _optional(path, _evaluation, notes))
        ],
        class_sizes=_optional(folder / names.ARTIFACT / ARTIFACT.json, _class_sizes, notes)
        or _optional(folder / names.PRETRAINED / ARTIFACT.json, _class_sizes, notes),
        notes=notes,
    )


def _read(path: Path, read: Callable[[Path], T]) -> T:
    if not path.is_file():
        raise UavrlError(f"{path.name} is missing: bring it back, or leave the folder out.")
    try:
        return read(path)
    except NoEpisodes:
        raise
    except OtherFormat as error:
        error.args = (str(error).replace(str(path), path.name),)
        raise
    except Exception as error:  # a file can be broken in more ways than can be named
        raise UavrlError(f"{path.name} cannot be read: mend it from a copy, or leave the folder out.") from error


def _optional(path: Path, read: Callable[[Path], T], notes: list[str]) -> T | None:
    """The content of a file that a run may lack; a broken one is noted."""
    try:
        return _read(path, read) if path.is_file() else None
    except OtherFormat as error:
        notes.append(f"{error} It is left out.")
        return None
    except UavrlError:
        notes.append(f"{path.name} cannot be read and is left out.")
        return None


def _require_keys(path: Path, content: Any, *keys: str, writer: str = "uavrl-train") -> None:
    """Tells a whole file of another format from a damaged one: it lacks one of these keys, given by dotted names."""
    for key in keys:
        node, names = content, key.split(".")
        for count, name in enumerate(names, 1):
            if not isinstance(node, Mapping) or name not in node:
                raise OtherFormat(path, f"key `{'.'.join(names[:count])}`", writer)
            node = node[name]


def _config(path: Path) -> dict[str, Any]:
    loaded = load_config(path)
    use_kept_directions(loaded, path.parent)
    by_content(loaded)
    config: Any = OmegaConf.to_container(loaded)
    if config:  # an empty file is a broken one
        _require_keys(path, config, "seed", "trainer.episodes", "choices.algo")
    seed, trainer, _ = int(config["seed"]), config["trainer"], learner_name(config["choices"])
    kinds = {"episodes": int, "steps": int, "window": int}
    limits = {key: kind(trainer[key]) for key, kind in kinds.items() if key == "episodes" or trainer.get(key)}
    return {**config, "seed": seed, "trainer": {**trainer, **limits}}


def _settings(config: dict[str, Any], choices: dict[str, str]) -> dict[str, Any]:
    """Its values, with the name of its yaml file in the place of each part's class and name."""
    values = flatten({key: value for key, value in config.items() if key != "choices"})
    named = {key: value for key, value in values.items() if key.rpartition(".")[2] not in ("_target_", "name")}
    return {group: choice for group, choice in choices.items() if group in PARTS and choice != NONE} | named


def _episodes(path: Path) -> list[Episode]:
    episodes = read_episodes(path)
    if not episodes and path.stat().st_size:  # of a file with its header
        raise NoEpisodes(f"{path.name} has no episode yet: let the run train on, or leave the folder out.")
    steps = [e.total_steps for e in episodes]
    grows = all(earlier < later for earlier, later in zip([0, *steps], [*steps, _MOST_STEPS], strict=True))
    if not (episodes and grows and all(isfinite(e.episode_return) for e in episodes)):
        raise ValueError("Expected one episode or more, steps that grow, and returns that are numbers.")
    return episodes


def _summary(path: Path) -> tuple[dict[str, Any], int | None]:
    content = json.loads(path.read_bytes())
    _require_keys(path, content, "versions")
    versions = {key: value for key, value in content["versions"].items() if value is not None}
    return versions, content.get("episodes")


def _class_sizes(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_bytes())
    _require_keys(path, content, "class_sizes", writer="uavrl-pretrain")
    sizes = content["class_sizes"]
    return {str(name): {"number": size.get("classes"), "sd": float(size["sd"])} for name, size in sizes.items()}


def _evaluation(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_bytes())
    _require_keys(path, content, "episodes", *(f"{name}.rate" for name in RATES), writer="uavrl-evaluate")
    tasks = int(content["episodes"])
    rates = {name: wilson(round(float(content[name]["rate"]) * tasks), tasks) for name in RATES}
    copied = {key: content.get(key) for key in _COPIED}
    measured = {"position_stats": _position_stats(content.get("position_stats")), **_smoothness(content)}
    guarded = content.get("guard_share")
    measured["guard_share"] = None if guarded is None else float(guarded)
    return {"file": path.name, "flown": _tasks(content), "episodes": tasks, **copied, **rates, **measured}


def _tasks(content: dict[str, Any]) -> str:
    """The tasks in words. Planes move at every step of a process's UAVs, so these are part of the tasks with planes."""
    seeds = content.get("valleys") or []  # of a file from anywhere
    valleys = seed_ranges(seeds) if all(isinstance(seed, int) for seed in seeds) else ", ".join(map(str, seeds))
    changes = [str(each) for each in content.get("overrides") or [] if str(each).startswith(("env.", "perception."))]
    uavs, processes = content.get("num_uavs"), content.get("processes", 1)  # of a file from anywhere: any values
    among = "" if processes == 1 else f" in each of {processes} processes"
    parts = [
        str(content.get("env")),
        f"valleys {valleys}" if valleys else "",
        f"{pluralize(int(content['episodes']), 'task')} of seed {content.get('seed')}",
        f"{uavs} UAV{'' if uavs == 1 else 's'} at a time{among}" if content.get("planes") else "",
        *sorted(changes),
    ]
    return ", ".join(part for part in parts if part)


def _smoothness(content: dict[str, Any]) -> dict[str, Any]:
    """How smooth the actions were, None where an evaluation does not say it."""
    change, reversals = content.get("action_change"), content.get("yaw_reversals")
    if change is None:
        return {"action_change": None, "yaw_reversals": None}
    components = [float(component) for component in change]
    share = None if reversals is None else float(reversals)
    if not all(map(isfinite, components)) or (share is not None and len(components) != 4):
        raise ValueError("Expected the change of each component of the action, forward, left, up and the yaw rate.")
    return {"action_change": components, "yaw_reversals": share}


def _position_stats(places: Any) -> dict[str, Any] | None:
    """The statistics of positions, or None where an evaluation has none."""
    if places is None:
        return None
    spreads = {key: {p: float(places[key][p]) for p in ("p5", "p50", "p95")} for key in ("altitude", "wall_distance")}
    first, second, third, fourth = map(float, places["height_quarters"])
    return {**spreads, "height_quarters": [first, second, third, fourth]}
