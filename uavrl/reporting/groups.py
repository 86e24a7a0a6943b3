"""Which runs are seeds of one another, what their groups are called and which settings tell them apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from uavrl.reporting.runs import LeftOut, Run, flatten

# Where a run's files go and how fast it computes, not what it learns: two seeds of a group may differ here.
HOW_IT_RUNS = (
    "run_dir",
    "resume",
    "choices",
    "packages",
    "logger",
    "device",
    "trainer.episodes",
    "trainer.until_success",
    "trainer.progress",
    "trainer.record_states",
    "trainer.keep_checkpoints",
    "trainer.execution",
    "trainer.threads",
    "trainer.window",
)
# What makes two success rates comparable at all; how many vehicles fly at a time does not.
TASK, NOT_TASK = ("env", "perception"), ("env.num_uavs",)
_SHOWN = 3  # differences that a sentence or a label names


@dataclass(frozen=True)
class Group:
    """Runs that differ in their seed alone.

    Attributes:
        label: short, and no other group of the report has it.
        runs: one for each seed, by seed.
        notes: what a reader should know before comparing it.
    """

    label: str
    runs: list[Run]
    notes: list[str] = field(default_factory=list)

    @property
    def seeds(self) -> list[int]:
        """Of its runs."""
        return [run.seed for run in self.runs]


def below(key: str, names: Iterable[str]) -> bool:
    """Whether a dotted key is one of ``names`` or stands below one.

    Examples:
        >>> below("env.world.size", ["env"]), below("environment", ["env"])
        (True, False)
    """
    return any(key == name or key.startswith(f"{name}.") for name in names)


def shown(value: Any) -> str:
    """A setting as a person reads it.

    Examples:
        >>> shown(None), shown(True), shown([400, 300]), shown(1e-4)
        ('–', 'true', '[400, 300]', '0.0001')
    """
    if value is None:
        return "–"
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def differences(settings: Sequence[dict[str, Any]], without: Iterable[str] = ()) -> dict[str, list[Any]]:
    """The keys whose values are not all equal, with the values; ``None`` where one has no such key.

    Examples:
        >>> differences([{"a": 1, "b": 2}, {"a": 1, "b": 3, "c": 4}])
        {'b': [2, 3], 'c': [None, 4]}
    """
    keys = dict.fromkeys(key for flat in settings for key in flat if not below(key, without))
    values = {key: [flat.get(key) for flat in settings] for key in keys}
    return {key: row for key, row in values.items() if any(value != row[0] for value in row)}


def same_task(runs: Sequence[Run]) -> tuple[list[Run], list[LeftOut]]:
    """The runs of the task that most of them fly, the first where two tasks tie; the others are left out.

    Success in one environment, or through one kind of perception, says nothing against success in another.
    """

    def task(run: Run) -> str:
        kept = {k: v for k, v in run.settings.items() if below(k, TASK) and not below(k, NOT_TASK)}
        return repr(sorted(kept.items()))

    if not runs:
        return [], []
    common, count = Counter(map(task, runs)).most_common(1)[0]
    kept = [run for run in runs if task(run) == common]
    left_out = []
    for run in runs:
        if task(run) != common:
            without = (*HOW_IT_RUNS, *NOT_TASK)
            pairs = differences([run.settings, kept[0].settings], without).items()
            told = [f"{key} is {shown(a)}, not {shown(b)}" for key, (a, b) in pairs if below(key, TASK)]
            others = "the run" if count == 1 else f"the {count} runs"
            more = f" and {len(told) - _SHOWN} more settings differ" if len(told) > _SHOWN else ""
            left_out.append(
                LeftOut(
                    str(run.folder),
                    f"It flies another task than {others} reported ({'; '.join(told[:_SHOWN])}{more}): "
                    f"give it a report of its own.",
                )
            )
    return kept, left_out


def group_runs(runs: Sequence[Run]) -> tuple[list[Group], list[LeftOut]]:
    """Puts seeds together; a seed that is there twice counts once, by its longest run."""
    members: dict[str, list[Run]] = {}
    for run in runs:
        learned = {k: v for k, v in run.settings.items() if not below(k, ("seed", *HOW_IT_RUNS))}
        members.setdefault(repr(sorted(learned.items())), []).append(run)
    left_out: list[LeftOut] = []
    distinct = [_one_per_seed(group, left_out) for group in members.values()]
    labels = _labels(distinct)
    return [Group(label, group, _notes(group)) for label, group in zip(labels, distinct, strict=True)], left_out


def _one_per_seed(runs: list[Run], left_out: list[LeftOut]) -> list[Run]:
    kept: dict[int, Run] = {}
    for run in sorted(runs, key=lambda run: -len(run.episodes)):
        first = kept.setdefault(run.seed, run)
        if first is not run:
            same = first.episodes[: len(run.episodes)] == run.episodes
            what = "a copy of" if same else "another run of the same configuration and seed as"
            left_out.append(LeftOut(str(run.folder), f"It is {what} {first.folder}, and a seed counts once."))
    return [kept[seed] for seed in sorted(kept)]


def _notes(runs: list[Run]) -> list[str]:
    notes = []
    for key, values in how_they_ran(runs).items():
        if below(key, ("logger", "trainer.progress")):
            continue
        told = ", ".join(f"{shown(value)} (seed {run.seed})" for value, run in zip(values, runs, strict=True))
        notes.append(f"Its runs differ in {key}: {told.replace(shown(None), 'not recorded')}.")
    return notes


def how_they_ran(runs: Sequence[Run]) -> dict[str, list[Any]]:
    """The settings of :data:`HOW_IT_RUNS`, as the runs recorded them, of which there are different values.

    A run that is older than a setting did not record it, which is no difference.
    """
    recorded = [{k: v for k, v in flatten(run.config).items() if below(k, HOW_IT_RUNS)} for run in runs]
    found = differences(recorded, ("run_dir", "resume"))
    return {key: values for key, values in found.items() if len({repr(v) for v in values if v is not None}) > 1}


def _short(key: str) -> str:
    """A key without its group."""
    group, _, rest = key.partition(".")
    return rest or group


def _labels(groups: Sequence[list[Run]]) -> list[str]:
    """The learner, with the reward where that differs, and with more settings where it does not suffice."""
    settings = [runs[0].settings for runs in groups]
    rewards = {flat.get("reward") for flat in settings}
    labels = [runs[0].learner for runs in groups]
    if len(rewards) > 1:
        labels = [f"{label} · {flat.get('reward')}" for label, flat in zip(labels, settings, strict=True)]
    result = list(labels)
    for label in {label for label in labels if labels.count(label) > 1}:
        alike = [i for i, other in enumerate(labels) if other == label]
        differing = differences([settings[i] for i in alike], ("seed", *HOW_IT_RUNS))
        for place, i in enumerate(alike):
            parts = [f"{_short(key)}={shown(values[place])}" for key, values in differing.items()]
            result[i] = " · ".join([label, *parts[:_SHOWN]])
    for i, label in enumerate(result):
        if label in result[:i]:
            result[i] = f"{label} · {i + 1}"
    return result
