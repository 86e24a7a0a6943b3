"""Everything a report says, from run folders to one dictionary of facts; page and JSON show the same ones."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

import uavrl
from uavrl.errors import UavrlError
from uavrl.reporting.comparison import compare_groups
from uavrl.reporting.groups import HOW_IT_RUNS, Group, differences, group_runs, how_they_ran, same_task, shown
from uavrl.reporting.learning_curves import curves, steps_to
from uavrl.reporting.runs import LeftOut, Run, read_runs
from uavrl.reporting.thesis import class_sizes, counterpart, thesis
from uavrl.training.episodes import RATES, Episode, wilson

FORMAT = 1  # of the JSON file
_TITLES = {"bipedal_hardcore": "Training runs of the hard-core bipedal walker"}


@dataclass(frozen=True)
class Report:
    """What :func:`make_report` found; rates in [0, 1], steps are environment steps of whole episodes.

    Attributes:
        title: of the page.
        made: when, in UTC.
        version: of uavrl.
        window: number of episodes that a rolling rate covers.
        threshold: the success rate that ``steps_to_threshold`` is about.
        env: name of the environment that all runs fly.
        groups: one for each configuration, over its seeds.
        runs: one for each run folder.
        curves: by group, quantity and axis (:class:`uavrl.reporting.learning_curves.Curve`).
        evaluations: one for each file that ``uavrl-evaluate`` wrote.
        comparisons: interquartile means and tests (:func:`uavrl.reporting.comparison.compare_groups`).
        thesis: its numbers beside those of the groups.
        settings: what differs between the groups, by key, in the order of the groups.
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
    comparisons: list[dict[str, Any]]
    thesis: dict[str, Any]
    settings: dict[str, list[str]]
    left_out: list[LeftOut]

    def facts(self) -> dict[str, Any]:
        """As plain dictionaries and lists, which JSON gives back as they are; numbers that are none are ``None``."""
        return {"format": FORMAT, **_plain(asdict(self))}

    def to_json(self) -> str:
        """The content of ``report.json``."""
        return json.dumps(self.facts(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def warnings(self) -> list[str]:
        """One sentence for each folder that is left out and each note on a run or a group."""
        notes = [f"{run['name']}: {note}" for run in self.runs for note in run["notes"]]
        notes += [f"{group['label']}: {note}" for group in self.groups for note in group["notes"]]
        return [f"{left.folder} is left out. {left.reason}" for left in self.left_out] + notes


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if isfinite(value) else None
    return value if value is None or isinstance(value, str | int | bool) else str(value)


def make_report(
    folders: Sequence[Path], *, window: int = 500, threshold: float = 0.78, title: str | None = None
) -> Report:
    """Reads run folders and works out what there is to say about them.

    Args:
        folders: run folders, and folders that hold some.
        window: number of episodes that a rolling rate covers.
        threshold: success rate in (0, 1] whose first reaching is told.
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
    env = str(groups[0].runs[0].choices.get("env"))
    rows = [_group_facts(group, window, threshold) for group in groups]
    return Report(
        title=title or _TITLES.get(env, f"Training runs in the {env} valley"),
        made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        version=uavrl.__version__,
        window=window,
        threshold=threshold,
        env=env,
        groups=rows,
        runs=[_run_facts(run, group.label, window, threshold) for group in groups for run in group.runs],
        curves={
            group.label: {
                name: {axis: asdict(curve) for axis, curve in by_axis.items()}
                for name, by_axis in curves([run.episodes for run in group.runs], window).items()
            }
            for group in groups
        },
        evaluations=[
            {**evaluation, "run": run.name, "group": group.label, "run_seed": run.seed, "run_steps": _steps(run)}
            for group in groups
            for run in group.runs
            for evaluation in run.evaluations
        ],
        comparisons=compare_groups(groups, window),
        thesis=_beside_the_thesis(groups, rows, window),
        settings=_settings(groups),
        left_out=left_out,
    )


def _steps(run: Run) -> int:
    return run.episodes[-1].total_steps


def last_rates(seeds: Sequence[Sequence[Episode]], window: int) -> dict[str, Any]:
    """Rates over the last ``window`` episodes of each seed together, with Wilson intervals, and their mean return."""
    last = [episode for episodes in seeds for episode in episodes[-window:]]
    rates = {name: wilson(sum(e.outcome == outcome for e in last), len(last)) for name, outcome in RATES.items()}
    return {"episodes": len(last), **rates, "mean_return": float(np.mean([e.episode_return for e in last]))}


def _run_facts(run: Run, group: str, window: int, threshold: float) -> dict[str, Any]:
    notes = list(run.notes)
    if not run.finished:
        notes.append(f"Unfinished: {len(run.episodes):,} of {run.planned:,} episodes.")
    if len(run.episodes) < window:
        notes.append(f"It has flown fewer than {window:,} episodes: its rates are over all {len(run.episodes):,}.")
    return {
        "name": run.name,
        "folder": str(run.folder),
        "group": group,
        "seed": run.seed,
        "episodes": len(run.episodes),
        "planned": run.planned,
        "finished": run.finished,
        "steps": _steps(run),
        "last": last_rates([run.episodes], window),
        "steps_to_threshold": steps_to(run.episodes, threshold, window),
        "versions": run.versions,
        "notes": notes,
        "config": run.config,
    }


def _group_facts(group: Group, window: int, threshold: float) -> dict[str, Any]:
    seeds = [run.episodes for run in group.runs]
    success = [last_rates([episodes], window)["success"]["rate"] for episodes in seeds]
    notes = list(group.notes)
    if len(seeds) == 1:
        notes.insert(0, f"One seed ({group.seeds[0]}): it shows what happened once, not what to expect.")
    if len({len(episodes) for episodes in seeds}) > 1:
        first = min(group.runs, key=lambda run: len(run.episodes))
        notes.append(
            f"Its seeds have flown different numbers of episodes: mean and band of its curves end where the first seed "
            f"ends (over episodes: seed {first.seed} after {len(first.episodes):,})."
        )
    commits = {str(run.versions["commit"]) for run in group.runs if "commit" in run.versions}
    if len(commits) > 1:
        notes.append(f"Its runs were made by different states of the code: {', '.join(sorted(commits))}.")
    return {
        "label": group.label,
        "runs": [run.name for run in group.runs],
        "seeds": group.seeds,
        "last": last_rates(seeds, window),
        "success_by_seed": success,
        "mean_success": float(np.mean(success)),
        "steps_to_threshold": [steps_to(episodes, threshold, window) for episodes in seeds],
        "notes": notes,
    }


def _beside_the_thesis(groups: list[Group], rows: list[dict[str, Any]], window: int) -> dict[str, Any]:
    reference, env = thesis(), groups[0].runs[0].choices.get("env")
    found = [counterpart(group) for group in groups]

    def ours(learner: str, reward: str, threshold: float | None = None) -> list[dict[str, Any]]:
        result = []
        for group, row, place in zip(groups, rows, found, strict=True):
            if isinstance(place, str) or place[:2] != (learner, reward):
                continue
            entry = {"group": group.label, "seeds": group.seeds, "unlike": place[2]}
            if threshold is None:
                entry["last"] = row["last"]
            else:
                entry["steps_to"] = [steps_to(run.episodes, threshold, window) for run in group.runs]
            result.append(entry)
        return result

    return {
        "source": reference["source"],
        "episodes": reference["episodes"],
        "window": reference["window"],
        "rates": [r | {"ours": ours(r["learner"], r["reward"])} for r in reference["rates"] if r["env"] == env],
        "steps_to": [
            r | {"ours": ours(r["learner"], r["reward"], r["threshold"])}
            for r in reference["steps_to"]
            if r["env"] == env
        ],
        "class_sizes": {"thesis": reference["class_sizes"], "ours": class_sizes(groups)},
        "without_row": {group.label: p for group, p in zip(groups, found, strict=True) if isinstance(p, str)},
    }


def _settings(groups: list[Group]) -> dict[str, list[str]]:
    learned = differences([group.runs[0].settings for group in groups], ("seed", *HOW_IT_RUNS))
    result = {key: [shown(value) for value in values] for key, values in learned.items()}
    for key, values in how_they_ran([run for group in groups for run in group.runs]).items():
        ordered = iter(shown(value) for value in values)
        result[key] = [" / ".join(dict.fromkeys(next(ordered) for _ in group.runs)) for group in groups]
    return result
