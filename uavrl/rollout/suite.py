"""The scenarios of ``uavrl-evaluate suite=…``, and one table of what came of them."""

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from uavrl.config.sentences import did_you_mean
from uavrl.config.yaml_files import conf_dir
from uavrl.errors import UavrlError
from uavrl.rollout.summary import number
from uavrl.runs.episodes import RATES

HOW = {"steps_per_arrival": ".0f", "median_clearance": ".2f"}  # arrivals flew, and how it is written


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
    """The rates of each scenario with their Wilson 95 % intervals, and how arrivals flew."""
    heads = f"{'collision':>12}{'time-out':>10}{'steps per arrival':>19}{'clearance':>11}"
    lines = [f"{'scenario':<13}{'success':>11}  {'(95 %)':<11}{heads}"]
    for name, result in results.items():
        success, collision, time_out = (result[key] for key in RATES)
        interval = f"{100 * success['low']:.1f}–{100 * success['high']:.1f}"
        steps, clearance = (number(result[key], form) for key, form in HOW.items())
        rates = f"{success['rate']:>11.1%}  {interval:<11}{collision['rate']:>12.1%}{time_out['rate']:>10.1%}"
        lines.append(f"{name:<13}{rates}{steps:>19}{clearance:>11}")
    return "\n".join(lines)
