"""The thesis's numbers, and which of them a group of runs can be held against."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from uavrl.reporting.groups import Group

TRADITIONAL, ABR, ABR_PLUS = "TR", "ABR", "ABR⁺"
_BACKWARD = {"abr": ABR, "abr_plus": ABR_PLUS}


@cache
def thesis() -> dict[str, Any]:
    """Success and collision rates, steps to a success rate and class sizes, each with its figure or table.

    Examples:
        >>> [row["success"] for row in thesis()["rates"] if row["learner"] == "td3_lg" and row["env"] == "static"]
        [0.62, 0.886]
    """
    return json.loads(Path(__file__).with_name("thesis.json").read_text(encoding="utf-8"))


def counterpart(group: Group) -> tuple[str, str, list[str]] | str:
    """Which row of the thesis a group stands beside.

    Returns:
        The row's learner and reward, and what of these is not the thesis's: the name of the reward beside a backward
        reward, LifeGuard's model, the number of episodes. No other setting is compared. Or one sentence that says why
        the group has no such row.
    """
    run = group.runs[0]
    reward, backward = (run.choices.get(name, "none") for name in ("reward", "backward_reward"))
    learner = run.learner.removesuffix(f"_{backward}")
    unlike = []
    if learner.endswith("_lg_mlp"):
        learner = learner.removesuffix("_mlp")
        unlike.append("LifeGuard is an MLP, not linear")
    if backward in _BACKWARD:
        column = _BACKWARD[backward]
        if reward != "navigation":
            unlike.append(f"reward={reward}, not navigation (Eq. 3.6)")
    elif reward == "traditional":
        column = TRADITIONAL
    else:
        return (
            f"reward={reward} with backward_reward={backward} has no row: the thesis has reward=traditional (TR) "
            f"and backward_reward=abr or abr_plus with reward=navigation."
        )
    env = run.choices.get("env")
    if not any((r["env"], r["learner"], r["reward"]) == (env, learner, column) for r in thesis()["rates"]):
        return f"{learner} with {column} in the environment {env} has no row in the thesis."
    flown = sorted({len(run.episodes) for run in group.runs})
    if flown != [thesis()["episodes"]]:
        unlike.append(f"{' and '.join(f'{n:,}' for n in flown)} episodes, not {thesis()['episodes']:,}")
    return learner, column, unlike


def class_sizes(groups: list[Group]) -> list[dict[str, Any]]:
    """Spread of ABR⁺'s class sizes beside Figure 4.2, from the runs that hold their artifact; each artifact once."""
    found: list[dict[str, Any]] = []
    for group in groups:
        for run in group.runs:
            if not isinstance(run.class_sizes, dict):
                continue
            rows = [
                {"classes": str(name), "number": sizes.get("classes"), "sd": sizes["sd"]}
                for name, sizes in run.class_sizes.items()
                if isinstance(sizes, dict) and isinstance(sizes.get("sd"), int | float)
            ]
            if rows and rows not in [entry["rows"] for entry in found]:
                found.append({"run": run.name, "rows": rows})
    return found
