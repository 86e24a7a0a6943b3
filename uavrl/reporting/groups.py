"""Groups of runs that differ in their seed alone, their labels and the settings that distinguish them."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from uavrl.reporting.runs import LeftOut, Run
from uavrl.runs.config import HOW_IT_RUNS
from uavrl.runs.labels import label

# Two success rates compare only where these parts are equal; the number of vehicles at a time does not matter.
TASK, NOT_TASK = ("env", "perception"), ("env.num_uavs",)
_SHOWN = 3  # differences that a sentence or a label names


@dataclass(frozen=True)
class Group:
    """Runs that differ in their seed alone, by seed; no other group of the report has the label."""

    label: str
    runs: list[Run]

    @property
    def seeds(self) -> list[int]:
        """Of its runs."""
        return [run.seed for run in self.runs]


def below(key: str, names: Iterable[str]) -> bool:
    """Whether a dotted key is one of ``names`` or below one."""
    return any(key == name or key.startswith(f"{name}.") for name in names)


def shown(value: Any) -> str:
    """A setting as a person reads it."""
    if value is None:
        return "–"
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def differences(settings: Sequence[dict[str, Any]], without: Iterable[str] = ()) -> dict[str, list[Any]]:
    """The keys whose values are not all equal, with the values; ``None`` where one has no such key."""
    keys = dict.fromkeys(key for flat in settings for key in flat if not below(key, without))
    values = {key: [flat.get(key) for flat in settings] for key in keys}
    return {key: row for key, row in values.items() if any(value != row[0] for value in row)}


def same_task(runs: Sequence[Run]) -> tuple[list[Run], list[LeftOut]]:
    """The runs of the most frequent task, the first where two tie; the others are left out.

    Success rates of different environments or kinds of perception do not compare.
    """

    def task(run: Run) -> str:
        return repr(sorted((k, v) for k, v in run.settings.items() if below(k, TASK) and not below(k, NOT_TASK)))

    tasks = Counter(map(task, runs))
    common = max(tasks, key=tasks.__getitem__, default="")
    kept = [run for run in runs if task(run) == common]
    left_out = []
    for run in runs:
        if task(run) != common:
            pairs = differences([run.settings, kept[0].settings], NOT_TASK).items()
            named = [f"{key} is {shown(a)}, not {shown(b)}" for key, (a, b) in pairs if below(key, TASK)][:_SHOWN]
            reason = f"Its task is another than that of most runs ({'; '.join(named)}): give it a report of its own."
            left_out.append(LeftOut(run.name, reason))
    return kept, left_out


def group_runs(runs: Sequence[Run]) -> tuple[list[Group], list[LeftOut]]:
    """Puts seeds together; a seed that is there twice counts once, by its longest run."""
    members: dict[str, list[Run]] = {}
    for run in sorted(runs, key=lambda run: -len(run.episodes)):
        learned = {k: v for k, v in run.settings.items() if not below(k, ("seed", *HOW_IT_RUNS))}
        members.setdefault(repr(sorted(learned.items())), []).append(run)
    groups, left_out = [], []
    for group in members.values():
        kept: dict[int, Run] = {}
        for run in group:
            first = kept.setdefault(run.seed, run)
            if first is not run:
                reason = f"It has the configuration and the seed of {first.name}: a seed counts once."
                left_out.append(LeftOut(run.name, reason))
        groups.append([kept[seed] for seed in sorted(kept)])
    return [Group(name, group) for name, group in zip(_labels(groups), groups, strict=True)], left_out


def _labels(groups: Sequence[list[Run]]) -> list[str]:
    """The label of each group; where several have the same, the settings that differ are added."""
    plain = [label(runs[0].choices) for runs in groups]
    result = list(plain)
    for name in {name for name in plain if plain.count(name) > 1}:
        alike = [i for i, other in enumerate(plain) if other == name]
        differing = differences([groups[i][0].settings for i in alike], ("seed", *HOW_IT_RUNS))
        for place, i in enumerate(alike):
            parts = [f"{key.partition('.')[2] or key}={shown(row[place])}" for key, row in differing.items()]
            result[i] = " · ".join([name, *parts[:_SHOWN]])
    return [name if name not in result[:i] else f"{name} · {i + 1}" for i, name in enumerate(result)]
