"""The thesis's numbers, and which of them a group of runs can be compared with."""

import json
from functools import cache
from pathlib import Path
from typing import Any

from uavrl.config import learner_name
from uavrl.reporting.groups import Group
from uavrl.reporting.learning_curves import steps_to
from uavrl_onboard.pluralize import pluralize

_BACKWARD = {"abr": "ABR", "abr_plus": "ABR⁺"}


@cache
def thesis() -> dict[str, Any]:
    """Success and collision rates, steps to a success rate and class sizes, each with its figure or table."""
    return json.loads(Path(__file__).with_name("thesis.json").read_text(encoding="utf-8"))


def counterpart(group: Group) -> tuple[str, str, list[str]] | str:
    """Learner and reward of the thesis's row for a group and the group's deviations, or why there is no row."""
    run = group.runs[0]
    reward, backward = (run.choices.get(name, "none") for name in ("reward", "backward_reward"))
    learner = learner_name(run.choices).removesuffix(f"_{backward}")
    unlike = []
    if learner.endswith("_lg_mlp"):
        learner = learner.removesuffix("_mlp")
        unlike.append("LifeGuard is an MLP, not linear")
    column = _BACKWARD.get(backward, "TR" if reward == "traditional" else None)
    env = run.choices.get("env")
    if not any((r["env"], r["learner"], r["reward"]) == (env, learner, column) for r in thesis()["rates"]):
        return f"The thesis has no row with reward={reward}, backward_reward={backward} and {learner} in {env}."
    if backward in _BACKWARD and reward != "navigation":
        unlike.append(f"reward={reward}, not navigation (Eq. 3.6)")
    lengths = sorted({len(run.episodes) for run in group.runs})
    if lengths != [thesis()["episodes"]]:
        several = [*(f"{n:,}" for n in lengths[:-1]), pluralize(lengths[-1], "episode")]
        unlike.append(f"{' and '.join(several)}, not {thesis()['episodes']:,}")
    return learner, str(column), unlike


def compare_with_thesis(groups: list[Group], rows: list[dict[str, Any]], window: int) -> dict[str, Any]:
    """The thesis's numbers of the groups' environment, each with ``ours``: the results of the groups of its row."""
    reference, env = thesis(), groups[0].runs[0].choices.get("env")
    places = [counterpart(group) for group in groups]

    def ours(row: dict[str, Any]) -> list[dict[str, Any]]:
        return [
            {"group": group.label, "seeds": group.seeds, "unlike": place[2], "last": facts["last"]}
            | {"steps_to": [steps_to(run.episodes, row.get("threshold", 1.0), window) for run in group.runs]}
            for group, facts, place in zip(groups, rows, places, strict=True)
            if not isinstance(place, str) and place[:2] == (row["learner"], row["reward"])
        ]

    sizes = {run.name: run.class_sizes for group in groups for run in group.runs if run.class_sizes}
    return {
        **{key: reference[key] for key in ("source", "episodes", "window")},
        **{key: [r | {"ours": ours(r)} for r in reference[key] if r["env"] == env] for key in ("rates", "steps_to")},
        "class_sizes": {"thesis": reference["class_sizes"], "ours": sizes},
        "without_row": {group.label: p for group, p in zip(groups, places, strict=True) if isinstance(p, str)},
    }
