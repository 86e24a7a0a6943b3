"""The content of a report, from run folders to one dictionary of facts; page and JSON show the same ones."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path, PurePath
from typing import Any

import numpy as np

import uavrl
from uavrl.errors import UavrlError
from uavrl.reporting.groups import HOW_IT_RUNS, Group, below, differences, group_runs, same_task, shown
from uavrl.reporting.learning_curves import curves, steps_to
from uavrl.reporting.runs import LeftOut, Run, flatten, read_runs
from uavrl.reporting.thesis import compare_with_thesis
from uavrl.runs.episodes import RATES, Episode, mean_terms, wilson
from uavrl_onboard.pluralize import pluralize

FORMAT = 2  # of the JSON file
_PLACES = ("run_dir", "resume")  # of the machine that made a run


@dataclass(frozen=True)
class Report:
    """The result of :func:`make_report`; rates in [0, 1], steps are environment steps of whole episodes.

    Attributes:
        title: of the page.
        made: when, in UTC.
        version: of uavrl.
        window: number of episodes that a rolling rate covers.
        threshold: the success rate that ``steps_to_threshold`` is about.
        env: name of the environment of all runs.
        groups: one for each configuration, over its seeds; the best first.
        runs: one for each run folder, in the order of the groups.
        curves: by group, quantity and axis (:func:`uavrl.reporting.learning_curves.curves`).
        evaluations: for each set of tasks, the groups that were evaluated in it, the best first, and each file.
        thesis: its numbers and those of the groups.
        settings: those that differ between the groups, by key, in the order of the groups.
        left_out: folders that are not reported, and why.
    """

    title: str
    made: str
    version: str
    window: int
    threshold: float
    env: str
    groups: list[dict[str, Any]]
    runs: list[dict[str, Any]]
    curves: dict[str, dict[str, dict[str, Any]]]
    evaluations: list[dict[str, Any]]
    thesis: dict[str, Any]
    settings: dict[str, list[str]]
    left_out: list[LeftOut]

    def facts(self) -> dict[str, Any]:
        """As plain dictionaries and lists, which JSON gives back as they are; numbers that are none are ``None``."""
        return {"format": FORMAT, **_each(asdict(self), _plain)}

    def to_json(self) -> str:
        """The content of ``report.json``."""
        return json.dumps(self.facts(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def rates(self) -> tuple[str, str, list[tuple[str, dict[str, float], int]]]:
        """The success rates that answer which group is best: where, the unit, and each group's label, rate and number.

        They are those of the evaluation of most seeds, where there is one, else those of the last training episodes.
        """
        for part in self.evaluations:
            if part["groups"]:
                rows = [(row["group"], row["success"], row["tasks"]) for row in part["groups"]]
                return f"evaluation in {part['flown']}", "task", rows
        rows = [(group["label"], group["last"]["success"], group["last"]["episodes"]) for group in self.groups]
        return "the last training episodes, with exploration noise", "training episode", rows

    def verdict(self) -> str:
        """Which group is ahead, in one sentence, or that none is; nothing of a single group."""
        _, _, rows = self.rates()
        (best, rate, _), *others = sorted(rows, key=lambda row: -row[1]["rate"])
        if not others:
            return ""
        if rate["low"] > max(other["high"] for _, other, _ in others):
            return f"{best} is ahead of all other groups: its interval lies above theirs."
        return "No group is ahead: the intervals overlap."

    def warnings(self) -> list[str]:
        """One sentence for each folder that is left out and each note on a run."""
        notes = [f"{run['name']}: {note}" for run in self.runs for note in run["notes"]]
        return [f"{left.folder} is left out. {left.reason}" for left in self.left_out] + notes


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    """A nested value as dictionaries and lists, with every leaf changed."""
    if isinstance(value, dict):
        return {str(key): _each(item, change) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_each(item, change) for item in value]
    return change(value)


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if isfinite(value) else None
    return value if value is None or isinstance(value, str | int | bool) else str(value)


def _without_place(value: Any) -> Any:
    """An absolute path shortened to its name: its folder means nothing on another machine."""
    return PurePath(value).name if isinstance(value, str) and PurePath(value).is_absolute() else value


def make_report(
    folders: Sequence[Path], *, window: int = 500, threshold: float = 0.78, title: str | None = None
) -> Report:
    """Reads run folders, and folders that hold some, and works out the facts about them.

    Args:
        folders: they are only read.
        window: number of episodes that a rolling rate covers.
        threshold: success rate in (0, 1]; the report gives the steps until it is first reached.
        title: of the page.

    Raises:
        UavrlError: when a number is out of range, or no folder holds a run that can be reported.
    """
    if window < 1:
        raise UavrlError(f"The window must be at least 1 episode, got {window}.")
    if not 0 < threshold <= 1:
        raise UavrlError(f"The threshold must be a rate in (0, 1], got {threshold:g}.")
    runs, left_out = read_runs(folders)
    runs, other_tasks = same_task(runs)
    groups, twice = group_runs(runs)
    left_out = [*left_out, *other_tasks, *twice]
    if not groups:
        reasons = "; ".join(f"{left.folder}: {left.reason}" for left in left_out)
        raise UavrlError(f"There is nothing to report. {reasons or 'Give one run folder or more.'}")
    facts = {group.label: _group_facts(group, window, threshold) for group in groups}
    groups = sorted(groups, key=lambda group: -facts[group.label]["mean_success"])
    rows = [facts[group.label] for group in groups]
    env = str(groups[0].runs[0].choices.get("env"))
    return Report(
        title=title or f"Training runs, env={env}",
        made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        version=uavrl.__version__,
        window=window,
        threshold=threshold,
        env=env,
        groups=rows,
        runs=[_run_facts(run, group.label, window, threshold) for group in groups for run in group.runs],
        curves={group.label: curves([run.episodes for run in group.runs], window) for group in groups},
        evaluations=_evaluations(groups),
        thesis=compare_with_thesis(groups, rows, window),
        settings=_settings(groups),
        left_out=[LeftOut(PurePath(left.folder).name, left.reason) for left in left_out],
    )


def last_rates(seeds: Sequence[Sequence[Episode]], window: int) -> dict[str, Any]:
    """Rates over the last ``window`` episodes of each seed together, with Wilson intervals, and their mean return."""
    last = [episode for episodes in seeds for episode in episodes[-window:]]
    rates = {name: wilson(sum(e.outcome == outcome for e in last), len(last)) for name, outcome in RATES.items()}
    mean_return = float(np.mean([e.episode_return for e in last]))
    return {"episodes": len(last), **rates, "mean_return": mean_return, "return_terms": mean_terms(last)}


def _run_facts(run: Run, group: str, window: int, threshold: float) -> dict[str, Any]:
    notes = list(run.notes)
    if not run.finished:
        notes.append(f"Unfinished: {len(run.episodes):,} of {pluralize(run.config['trainer']['episodes'], 'episode')}.")
    if len(run.episodes) < window:
        notes.append(
            f"It has {pluralize(len(run.episodes), 'episode')}, fewer than {window:,}: its rates are over all of them."
        )
    return {
        "name": run.name,
        "group": group,
        "seed": run.seed,
        "episodes": len(run.episodes),
        "steps": run.steps,
        "last": last_rates([run.episodes], window),
        "steps_to_threshold": steps_to(run.episodes, threshold, window),
        "versions": run.versions,
        "notes": notes,
        "config": _each({key: value for key, value in run.config.items() if key not in _PLACES}, _without_place),
    }


def _group_facts(group: Group, window: int, threshold: float) -> dict[str, Any]:
    seeds = [run.episodes for run in group.runs]
    success = [last_rates([episodes], window)["success"]["rate"] for episodes in seeds]
    notes = []
    if len(seeds) == 1:
        notes.append("One seed: the spread between seeds is unknown.")
    if len({len(episodes) for episodes in seeds}) > 1:
        notes.append(f"Its seeds have {min(map(len, seeds)):,} to {max(map(len, seeds)):,} episodes.")
    if len({str(run.versions["commit"]) for run in group.runs if "commit" in run.versions}) > 1:
        notes.append("Its runs were made by different states of the code.")
    return {
        "label": group.label,
        "seeds": group.seeds,
        "last": last_rates(seeds, window),
        "success_by_seed": success,
        "mean_success": float(np.mean(success)),
        "steps_to_threshold": [steps_to(episodes, threshold, window) for episodes in seeds],
        "demonstrated": demonstrated(group),
        "notes": notes,
    }


def demonstrated(group: Group) -> dict[str, int] | None:
    """How long the scripted controller flew at the start of each run: in steps, and in episodes; None without one.

    Episodes are those that ended within these steps, in the seed that had most of them.
    """
    config = group.runs[0].config
    demonstrator, steps = config.get("demonstrator") or {}, (config.get("algo") or {}).get("learning_starts")
    if demonstrator.get("_target_") is None or not isinstance(steps, int) or steps < 1:
        return None
    ended = [sum(episode.total_steps <= steps for episode in run.episodes) for run in group.runs]
    return {"steps": steps, "episodes": max(ended)}


def _evaluations(groups: Sequence[Group]) -> list[dict[str, Any]]:
    """By sets of tasks, that of most seeds first; of two files of one run the longer trained counts for its group."""
    files = [
        {**evaluation, "run": run.name, "group": group.label, "run_seed": run.seed}
        for group in groups
        for run in group.runs
        for evaluation in run.evaluations
    ]
    result = []
    for tasks in dict.fromkeys(each["flown"] for each in files):
        alike = [each for each in files if each["flown"] == tasks]
        newest = {each["run"]: each for each in sorted(alike, key=_trained) if each["policy"] is None}
        by_group = [[each for each in newest.values() if each["group"] == group.label] for group in groups]
        rows = [_pooled(members) for members in by_group if members]
        rows.sort(key=lambda row: -row["success"]["rate"])
        result.append({"flown": tasks, "groups": rows, "files": alike})
    return sorted(result, key=lambda part: -sum(len(row["seeds"]) for row in part["groups"]))


def _trained(evaluation: dict[str, Any]) -> float:
    steps = evaluation["training_steps"]
    return float(steps) if isinstance(steps, int | float) else 0.0


def _pooled(evaluations: list[dict[str, Any]]) -> dict[str, Any]:
    """Rates of a group over the tasks of all its seeds together."""
    tasks = sum(each["episodes"] for each in evaluations)
    counts = {name: sum(round(each[name]["rate"] * each["episodes"]) for each in evaluations) for name in RATES}
    return {
        "group": evaluations[0]["group"],
        "seeds": [each["run_seed"] for each in evaluations],
        "tasks": tasks,
        "success_by_seed": [each["success"]["rate"] for each in evaluations],
        **{name: wilson(count, tasks) for name, count in counts.items()},
    }


def _settings(groups: list[Group]) -> dict[str, list[str]]:
    """The settings that differ between groups, and those of how their runs ran where these were recorded and differ."""
    learned = differences([group.runs[0].settings for group in groups], ("seed", *HOW_IT_RUNS))
    result = {key: [shown(value) for value in values] for key, values in learned.items()}
    ran = [[flatten(run.config) for run in group.runs] for group in groups]
    keys = {key: None for group in ran for flat in group for key in flat if below(key, HOW_IT_RUNS)}
    for key in (key for key in keys if not below(key, (*_PLACES, "choices"))):
        values = [[shown(flat.get(key)) for flat in group] for group in ran]
        if len({value for group in values for value in group} - {shown(None)}) > 1:
            result[key] = [" / ".join(dict.fromkeys(group)) for group in values]
    return result
