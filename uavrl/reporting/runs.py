"""Run folders, read: what is whole becomes a :class:`Run`, what is not is left out with one sentence."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from uavrl.configs import learner
from uavrl.configs.parts import PARTS
from uavrl.configs.registry import NONE
from uavrl.configs.saved import load_config
from uavrl.errors import UavrlError
from uavrl.reporting.evaluations import read_evaluations, read_json
from uavrl.training.episodes import Episode, read_episodes

CONFIG, EPISODES, SUMMARY, POLICY = "config.yaml", "episodes.csv", "summary.json", "policy.json"
_DEPTH = 4  # of folders that are searched for runs
_MOST_STEPS = 2**53  # from there on a double, which a page counts in, skips numbers


@dataclass(frozen=True)
class Run:
    """One run folder.

    Attributes:
        folder: where it lies, as it was given.
        name: what it is called in a report.
        config: its configuration as its file has it.
        settings: its values by their dotted names (see :func:`flatten`).
        choices: the yaml file of each part, by the part's name.
        learner: what learns, as :func:`uavrl.configs.learner` names it.
        seed: of the run.
        episodes: at least one.
        planned: number of episodes that the run is to fly.
        versions: of uavrl and torch, and the commit, where the run recorded them.
        evaluations: what ``uavrl-evaluate`` left in the folder, each with its ``file``, without single flights.
        class_sizes: of the trajectory classes that ABR⁺ gave its reward by, or that ``uavrl-pretrain`` made of the
            run's states, where the folder holds them.
        notes: what is wrong with it, though it can be reported.
    """

    folder: Path
    name: str
    config: dict[str, Any]
    settings: dict[str, Any]
    choices: dict[str, str]
    learner: str
    seed: int
    episodes: list[Episode]
    planned: int
    versions: dict[str, Any] = field(default_factory=dict)
    evaluations: list[dict[str, Any]] = field(default_factory=list)
    class_sizes: dict[str, Any] | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def finished(self) -> bool:
        """Whether it has flown all its episodes."""
        return len(self.episodes) >= self.planned


@dataclass(frozen=True)
class LeftOut:
    """A folder that is not reported, and what to do about it."""

    folder: str
    reason: str


def flatten(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The values of a nested mapping by dotted names; ``None`` and empty mappings are left out.

    Examples:
        >>> flatten({"algo": {"name": "td3", "fork": None, "hidden": (400, 300)}, "seed": 0})
        {'algo.name': 'td3', 'algo.hidden': [400, 300], 'seed': 0}
    """
    flat: dict[str, Any] = {}
    for key, value in node.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{name}.")
        elif value is not None:
            flat[name] = list(value) if isinstance(value, tuple) else value
    return flat


def find_run_folders(folders: Sequence[Path]) -> tuple[list[Path], list[LeftOut]]:
    """Run folders among ``folders`` and below them, each once; and those in which there is none.

    A run folder holds ``config.yaml`` or ``episodes.csv``; nothing below it is searched.
    """
    found: dict[Path, Path] = {}
    left_out: list[LeftOut] = []
    for folder in folders:
        unreadable: list[LeftOut] = []
        try:
            exists = folder.is_dir()
        except OSError as error:
            left_out.append(_unreadable(folder, error))
            continue
        if not exists:
            no_folder = "It is no folder: give the one that uavrl-train printed."
            absent = "There is no such folder: check the path."
            left_out.append(LeftOut(str(folder), no_folder if folder.exists() else absent))
            continue
        runs = list(_search(folder, _DEPTH, unreadable))
        left_out += [left for left in unreadable if left not in left_out]
        if not runs and not unreadable:
            left_out.append(LeftOut(str(folder), "It holds no run: give the folder that uavrl-train printed."))
        for run in runs:
            found.setdefault(run.resolve(), run)
    return list(found.values()), left_out


def _search(folder: Path, depth: int, unreadable: list[LeftOut]) -> Iterator[Path]:
    children: list[Path] = []
    try:
        is_run = any((folder / name).exists() for name in (CONFIG, EPISODES))
        if depth and not is_run:
            children = sorted(child for child in folder.iterdir() if child.name[0] != "." and child.is_dir())
    except OSError as error:
        unreadable.append(_unreadable(folder, error))
        return
    if is_run:
        yield folder
    for child in children:
        yield from _search(child, depth - 1, unreadable)


def _unreadable(folder: Path, error: OSError) -> LeftOut:
    return LeftOut(str(folder), f"It cannot be read ({error.strerror or error}): check its permissions.")


def read_runs(folders: Sequence[Path]) -> tuple[list[Run], list[LeftOut]]:
    """Reads all runs in and below ``folders``.

    Returns:
        The runs, in the order of the folders, and what is left out: nothing here raises for a damaged folder.
    """
    found, left_out = find_run_folders(folders)
    names = [folder.resolve().name for folder in found]
    runs = []
    for folder, name in zip(found, names, strict=True):
        unique = name if names.count(name) == 1 else f"{folder.resolve().parent.name}/{name}"
        try:
            runs.append(read_run(folder, unique))
        except (UavrlError, OSError) as error:
            left_out.append(LeftOut(str(folder), str(error)))
        except Exception as error:  # a file can be damaged in more ways than can be named; the others are reported
            reason = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
            left_out.append(LeftOut(str(folder), f"It cannot be read ({reason}): mend its files, or leave it out."))
    return runs, left_out


def read_run(folder: Path, name: str | None = None) -> Run:
    """Reads one run folder.

    Raises:
        UavrlError: naming the file that is missing or damaged and what to do.
    """
    notes: list[str] = []
    if (folder / POLICY).is_file():
        raise UavrlError("It is an exported policy, which has no training to report: give the folder of its run.")
    config = _read_config(folder / CONFIG)
    episodes = _read_episodes(folder / EPISODES, notes)
    try:
        choices = _choices(config)
        seed, planned, label = int(config["seed"]), int(config["trainer"]["episodes"]), learner(choices)
    except Exception as error:
        raise _damaged(folder / CONFIG, f"it has no proper seed, trainer.episodes or algo ({error})") from error
    return Run(
        folder=folder,
        name=name or folder.resolve().name,
        config=config,
        settings=_settings(config, choices),
        choices=choices,
        learner=label,
        seed=seed,
        episodes=episodes,
        planned=planned,
        versions=_versions(folder, len(episodes), notes),
        evaluations=read_evaluations(folder, notes),
        class_sizes=_class_sizes(folder, notes),
        notes=notes,
    )


def _damaged(path: Path, reason: str) -> UavrlError:
    return UavrlError(f"{path.name} is damaged: {reason}. Mend the file from a copy, or leave the folder out.")


def _missing(path: Path, holds: str) -> UavrlError:
    return UavrlError(f"{path.name} is missing, which holds {holds}: bring it back, or leave the folder out.")


def _read_config(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise _missing(path, "the configuration of the run")
    try:
        plain = OmegaConf.to_container(load_config(path))
    except Exception as error:  # yaml, OmegaConf and the decoder each have their own
        raise _damaged(path, " ".join(str(error).split())[:120]) from error
    groups = ("env", "perception", "reward", "algo", "trainer")
    if not isinstance(plain, dict):
        raise _damaged(path, "it holds no configuration")
    for group in groups:
        if not isinstance(plain.get(group), dict):
            raise _damaged(path, f"{group} is not in it")
    return {str(key): value for key, value in plain.items()}


def _settings(config: dict[str, Any], choices: dict[str, str]) -> dict[str, Any]:
    """Its values, and in the place of each part's class and name which yaml file it came from."""
    values = flatten({key: value for key, value in config.items() if key != "choices"})
    named = {key: value for key, value in values.items() if key.rpartition(".")[2] not in ("_target_", "name")}
    return {group: choice for group, choice in choices.items() if group in PARTS and choice != NONE} | named


def _choices(config: dict[str, Any]) -> dict[str, str]:
    """The choices that made a configuration; those of an older uavrl were told by names among the values."""
    if "choices" in config:
        return {str(group): str(choice) for group, choice in config["choices"].items()}
    algo, guard = config["algo"], config["algo"].get("lifeguard")
    parts = {group: config.get(group) for group in PARTS}
    return {
        **{group: str(part["name"]) for group, part in parts.items() if isinstance(part, dict) and "name" in part},
        "algo": str(algo["name"]).split("_")[0],
        "fork": "on" if algo.get("fork") else NONE,
        "lifeguard": str(guard["model"]) if guard else NONE,
    }


def _read_episodes(path: Path, notes: list[str]) -> list[Episode]:
    if not path.is_file():
        raise _missing(path, "what the run has flown")
    try:
        episodes = read_episodes(path)
    except UavrlError as error:
        raise UavrlError(f"{error} Mend the file from a copy, or leave the folder out.") from error
    if not episodes:
        raise UavrlError(f"{path.name} holds no whole episode: wait until the run has flown one.")
    steps = [e.total_steps for e in episodes]
    if any(later <= earlier for earlier, later in zip([0, *steps], steps, strict=False)):
        raise _damaged(path, "total_steps does not grow from row to row")
    if steps[-1] >= _MOST_STEPS:
        raise _damaged(path, f"total_steps reaches {steps[-1]}")
    if unknown := sum(not math.isfinite(e.episode_return) for e in episodes):
        notes.append(f"{unknown:,} of its returns in {path.name} are no numbers, and so are the means over them.")
    with path.open("rb") as file:
        file.seek(-1, 2)
        if file.read() != b"\n":
            notes.append(f"The last row of {path.name} is cut off and does not count.")
    return episodes


def _class_sizes(folder: Path, notes: list[str]) -> dict[str, Any] | None:
    for made in ("artifact", "pretrained"):
        about = read_json(folder / made / "artifact.json", notes)
        if about is not None:
            return about.get("class_sizes")
    return None


def _versions(folder: Path, episodes: int, notes: list[str]) -> dict[str, Any]:
    """From ``summary.json``; where the run has gone on since, from its newest checkpoint."""
    summary = read_json(folder / SUMMARY, notes) or {}
    told = summary.get("versions")
    ended = {key: value for key, value in told.items() if value is not None} if isinstance(told, dict) else {}
    return ended if ended and summary.get("episodes") == episodes else _versions_of_checkpoint(folder) or ended


def _versions_of_checkpoint(folder: Path) -> dict[str, Any]:
    for path in sorted((folder / "checkpoints").glob("checkpoint*"), reverse=True):
        try:
            with zipfile.ZipFile(path) as archive:
                metadata = json.loads(archive.read("manifest.json"))["metadata"]
            return {key: metadata[key] for key in ("uavrl", "commit") if metadata.get(key) is not None}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError, zipfile.BadZipFile):
            continue  # being written, or damaged: another one may say it
    return {}
