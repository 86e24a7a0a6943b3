"""Groups of seeds against each other: interquartile means and tests, for each way of scoring a seed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from uavrl.reporting.groups import Group
from uavrl.reporting.statistics import compare, holm, stratified_iqm

TRAINING, EVALUATION = "training", "evaluation"
_SIGNIFICANT = 0.05
# A change of environment or sensor in the name that uavrl-evaluate gives its file, up to the next one.
_CHANGE = re.compile(r"_((?:env|perception)\.[a-z0-9_.]+=.*?)(?=_[a-z][a-z0-9_.]*=|$)")


def compare_groups(groups: Sequence[Group], window: int) -> list[dict[str, Any]]:
    """Interquartile means, and tests of each pair of groups that has two seeds or more on either side.

    Args:
        groups: of the report.
        window: number of last training episodes that give a seed its score.

    Returns:
        For each way of scoring (in training; in evaluations that all seeds of all evaluated groups flew alike):
        ``score``, ``tasks``, the ``iqm`` of each group with its interval, the ``tests`` of each pair, with p values
        before and after Holm's correction over the pairs, and a ``reading``: how much so many seeds can show.
    """
    training = {group.label: np.array([[_success(run, window)] for run in group.runs]) for group in groups}
    result = [_compare(TRAINING, [f"last {window} training episodes"], training)]
    result[0]["reading"] += _flown_differently(groups)
    conditions, evaluated, steps = _evaluated(groups)
    if conditions:
        part = _compare(EVALUATION, [_told(condition) for condition in conditions], evaluated)
        part["reading"] += _trained_differently(conditions, steps)
        result.append(part)
    result[-1]["reading"] += _not_compared(groups, conditions)
    return result


def _not_compared(groups: Sequence[Group], conditions: list[tuple[str, ...]]) -> list[str]:
    """Which evaluations are there and do not count in the comparison."""
    flown = {group.label: [_conditions(run.evaluations) for run in group.runs] for group in groups}
    sentences = [
        f"The evaluations of {group.label} are not compared: seed "
        f"{', '.join(str(run.seed) for run, seen in zip(group.runs, flown[group.label], strict=True) if not seen)} "
        f"has none."
        for group in groups
        if any(flown[group.label]) and not all(flown[group.label])
    ]
    whole = [label for label, seeds in flown.items() if all(seeds)]
    if whole and not conditions:
        sentences.append(
            f"No evaluation is compared: none was flown alike by all seeds of {', '.join(whole)}. What must agree is "
            f"the environment, valleys, seed and number of tasks, and with planes num_uavs."
        )
    return sentences


def _flown_differently(groups: Sequence[Group]) -> list[str]:
    """A sentence, if the runs have not flown equally long."""
    flown = sorted({len(run.episodes) for group in groups for run in group.runs})
    if len(flown) < 2:
        return []
    return [f"The runs have not flown equally long: {flown[0]:,} to {flown[-1]:,} episodes, of which the last count."]


def _success(run: Any, window: int) -> float:
    return float(np.mean([episode.outcome == "arrived" for episode in run.episodes[-window:]]))


def _conditions(evaluations: list[dict[str, Any]]) -> dict[tuple[str, ...], tuple[float, float]]:
    """Success and training steps by what was flown; of two evaluations of the same the longer trained counts.

    The same is what agrees in environment, valleys, seed, number of tasks, and changes of environment and sensor, and
    with planes, which move with the steps of all, in the number of UAVs.
    Older files, without ``overrides``, tell the last in the name alone that ``uavrl-evaluate`` gave them.
    What a policy that learns nothing flew (``policy=straight``) is none of the run's.
    """
    learned = [evaluation for evaluation in evaluations if "policy" not in evaluation]
    return {
        (*(str(e.get(key)) for key in ("env", "valleys", "seed", "episodes")), _together(e), _changes(e)): (
            float(e["success"]["rate"]),
            _number(e.get("training_steps")),
        )
        for e in sorted(learned, key=lambda e: _number(e.get("training_steps")))
    }


def _together(evaluation: dict[str, Any]) -> str:
    planes = evaluation.get("planes")
    if planes is None:  # an older file
        planes = evaluation.get("env") == "dynamic" or "env.world.planes=" in _changes(evaluation)
    return str(evaluation.get("num_uavs")) if planes else ""


def _changes(evaluation: dict[str, Any]) -> str:
    told = evaluation.get("overrides")
    if not isinstance(told, list):
        return ", ".join(sorted(_CHANGE.findall(Path(str(evaluation["file"])).stem)))
    return ", ".join(sorted(str(override) for override in told if str(override).startswith(("env.", "perception."))))


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def _told(condition: tuple[str, ...]) -> str:
    """What was flown, for a person.

    Examples:
        >>> _told(("dynamic", "[0]", "20000", "500", "8", "")), _told(("walker", "None", "20000", "100", "", ""))
        ('dynamic, valleys [0], 500 tasks of seed 20000, 8 UAVs at a time', 'walker, 100 tasks of seed 20000')
    """
    env, valleys, seed, episodes, together, changes = condition
    place = env if valleys == str(None) else f"{env}, valleys {valleys}"  # the walker has none
    several = together and f", {together} UAVs at a time"
    return f"{place}, {episodes} tasks of seed {seed}{several}{changes and f' with {changes}'}"


def _trained_differently(conditions: list[tuple[str, ...]], steps: np.ndarray) -> list[str]:
    """A sentence for each condition, if any, in which checkpoints of different age flew; ``steps`` by condition."""
    return [
        f"In {_told(condition)}, the checkpoints have not trained equally long: {min(row):,.0f} to {max(row):,.0f} "
        f"steps (0 where it is not recorded)."
        for condition, row in zip(conditions, steps, strict=True)
        if min(row) != max(row)
    ]


def _evaluated(groups: Sequence[Group]) -> tuple[list[tuple[str, ...]], dict[str, np.ndarray], np.ndarray]:
    """The evaluations that every seed of every evaluated group has.

    Returns:
        What was flown, the success ``[seeds, conditions]`` of each group, and the training steps
        ``[conditions, seeds]`` of all groups together.
    """
    flown = {group.label: [_conditions(run.evaluations) for run in group.runs] for group in groups}
    flown = {label: seeds for label, seeds in flown.items() if all(seeds)}
    if not flown:
        return [], {}, np.zeros((0, 0))
    common = set.intersection(*(set(seed) for seeds in flown.values() for seed in seeds))
    conditions = sorted(common)
    success = {label: np.array([[seed[c][0] for c in conditions] for seed in seeds]) for label, seeds in flown.items()}
    steps = [[seed[c][1] for seeds in flown.values() for seed in seeds] for c in conditions]
    return conditions, success, np.array(steps)


def _compare(score: str, tasks: list[str], scores: dict[str, np.ndarray]) -> dict[str, Any]:
    several = {label: values for label, values in scores.items() if len(values) >= 2}
    tests = []
    for first, second in combinations(several, 2):
        found = compare(several[first].mean(axis=1).tolist(), several[second].mean(axis=1).tolist())
        seeds = [len(several[first]), len(several[second])]
        tests.append({"first": first, "second": second, "seeds": seeds, **asdict(found)})
    for name in ("welch", "permutation"):
        known = [test for test in tests if test[name] is not None]
        for test, corrected in zip(known, holm([test[name] for test in known]), strict=True):
            test[f"{name}_holm"] = corrected
        for test in tests:
            test.setdefault(f"{name}_holm", None)
    return {
        "score": score,
        "tasks": tasks,
        "iqm": [
            {"group": label, "seeds": len(values), **asdict(stratified_iqm(values))} for label, values in scores.items()
        ],
        "tests": tests,
        "reading": _reading(tests, [label for label in scores if label not in several], scores),
    }


def _reading(tests: list[dict[str, Any]], one_seed: list[str], scores: dict[str, np.ndarray]) -> list[str]:
    """How much, or little, the numbers can show."""
    sentences = []
    for seeds, least in sorted({(tuple(sorted(test["seeds"])), test["least"]) for test in tests}):
        told = f"With {seeds[0]} seeds against {seeds[1]} the permutation test can give no p below {least:.2g}"
        sentences.append(
            f"{told}: it cannot call any difference significant at 5 %, whatever the seeds do."
            if least > _SIGNIFICANT
            else f"{told}, before the correction for {len(tests)} pairs."
        )
    if any(2 in test["seeds"] for test in tests):
        sentences.append(
            "Two seeds show next to nothing about the spread between seeds: Welch's test then rests on the assumption "
            "that seeds are spread normally, and the bootstrap interval is no more than the two seeds themselves."
        )
    if not tests:
        sentences.append("No pair is tested: that takes two groups with two seeds or more each.")
    if one_seed:
        sentences.append(f"One seed, so neither interval nor test: {', '.join(one_seed)}.")
    if any(len(values) >= 2 and values.size < 4 for values in scores.values()):
        sentences.append("Of fewer than four scores the interquartile mean cuts nothing off: it is their mean.")
    return sentences
