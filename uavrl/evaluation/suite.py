"""The scenarios of ``uavrl-evaluate suite=…``, and the table of their results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from uavrl.config.yaml_files import conf_dir
from uavrl.errors import UavrlError
from uavrl.evaluation.summary import OTHERS, number_text
from uavrl.runs.episodes import rate_cell
from uavrl_onboard.sentences import did_you_mean


def scenarios(asked: str | Sequence[str]) -> dict[str, list[str]]:
    """What each scenario of ``conf/suite.yaml`` that is asked for changes; ``"all"`` asks for every one."""
    suite: dict[str, list[str]] = yaml.safe_load((conf_dir() / "suite.yaml").read_text(encoding="utf-8"))
    if asked == "all":
        return suite
    names = [asked] if isinstance(asked, str) else list(asked)
    for name in names:
        if name not in suite:
            known = f"suite must be all or some of {', '.join(suite)}, got {name!r}"
            raise UavrlError(known + did_you_mean(str(name), suite, ": "))
    return {name: suite[name] for name in names}


def suite_table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """The rates of each scenario, steps and clearance of its successes, and smoothness.

    The change is the mean absolute change of the yaw rate from step to step; reversals are of the yaw rate;
    guarded is the share of steps in which guards changed the velocity. The success by detour is that of parts of the
    tasks, those with the least detour first.
    """
    heads = ["success, % (95 % CI)", "collision, %", "time-out, %", "steps per success", "clearance, m"]
    heads += ["yaw rate change, rad/s", "reversals, %", "guarded, %", "by detour, %"]
    lines = [f"{'scenario':<14}" + "  ".join(heads)]
    for name, result in results.items():
        shares = [result.get(key) for key in ("yaw_reversals", "guard_share")]
        others = [100 * result[key]["rate"] for key in OTHERS]
        cells = (
            rate_cell(result["success"]),
            *(f"{share:.1f}" for share in others),
            number_text(result["steps_per_arrival"], ".0f"),
            number_text(result["median_clearance"], ".2f"),
            number_text((result.get("action_change") or [None])[-1], ".2f"),
            *(number_text(None if share is None else 100 * share, ".1f") for share in shares),
            _detour_cell(result),
        )
        lines.append(f"{name:<14}" + "  ".join(f"{c:>{len(h)}}" for c, h in zip(cells, heads, strict=True)))
    return "\n".join(lines)


def _detour_cell(result: Mapping[str, Any]) -> str:
    shares = [100 * each["rate"] for each in result.get("success_by_detour", ())]
    return " / ".join(f"{share:.0f}" for share in shares) or "–"
