"""The rates of some episodes, as numbers and as a table, and those of the scenarios of ``uavrl-evaluate suite=…``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from uavrl.config.yaml_files import conf_dir
from uavrl.errors import UavrlError
from uavrl.evaluation.position_stats import position_lines
from uavrl.evaluation.smoothness import smoothness_lines, summarize_smoothness
from uavrl.runs.episodes import LETTERS, RATES, wilson
from uavrl_onboard.pluralize import pluralize
from uavrl_onboard.sentences import did_you_mean

if TYPE_CHECKING:
    from uavrl.envs.difficulty import Difficulty
    from uavrl.evaluation.rollout import EpisodeResult

LABELS = {
    "path_efficiency": "path efficiency (straight / flown, successes)",
    "median_clearance": "minimum clearance, median over successes [m]",
    "min_clearance": "minimum clearance, least of all successes [m]",
    "mean_return": "return, mean",
    "sd_return": "return, standard deviation",
    "median_return": "return, median",
    "steps_per_episode": "steps per episode",
    "steps_per_arrival": "steps per success",
}
# What tells how hard a task is: its label and its unit.
DIFFICULTY = {"detour": ("detour", ""), "spacing": ("free width", " m")}
LEAST_TASKS = 9  # of which three parts are told


def summarize(flights: Sequence[EpisodeResult]) -> dict[str, Any]:
    """Rates with Wilson 95 % intervals, path efficiency and clearance, or returns, and steps.

    Path efficiency is the mean over successes; the minimum clearance (hull to nearest thing) is given as the median
    over successes and as the least of them; what has no value without them is ``None``. Several valleys are also
    counted one by one, by their seed. ``outcomes`` has a letter for each episode: success, collision or time-out.
    ``action_change`` and ``yaw_reversals`` are over all steps (:mod:`uavrl.evaluation.smoothness`).

    Examples:
        >>> from uavrl.evaluation.rollout import EpisodeResult
        >>> arrived = EpisodeResult(0, "arrived", 100, 0, 18.0, 20.0, 0.4)
        >>> result = summarize([arrived, EpisodeResult(1, "collided", 50, 0, 5.0, 6.0, 0.0)])
        >>> result["success"]["rate"], result["path_efficiency"], result["steps_per_episode"], result["outcomes"]
        (0.5, 0.9, 75.0, 'SC')
    """
    if not flights:
        raise ValueError("Expected at least one episode to summarise, got none.")
    outcomes = [flight.outcome for flight in flights]
    result: dict[str, Any] = {"episodes": len(flights)}
    result |= {name: wilson(outcomes.count(ending), len(flights)) for name, ending in RATES.items()}
    result["outcomes"] = "".join(LETTERS[ending] for ending in outcomes)
    arrived = [flight for flight in flights if flight.outcome == "arrived"]
    valleys = sorted({flight.world_seed for flight in flights if flight.world_seed is not None})
    if len(valleys) > 1:
        result["success_by_valley"] = {str(valley): _success_in(valley, flights) for valley in valleys}
    returns = [flight.episode_return for flight in flights if flight.episode_return is not None]
    if returns:
        result["mean_return"] = float(np.mean(returns))
        result["sd_return"] = float(np.std(returns))
        result["median_return"] = float(np.median(returns))
    else:
        clearances = [flight.clearance for flight in arrived if flight.clearance is not None]
        efficiencies = [each for flight in arrived if (each := flight.path_efficiency) is not None]
        result["path_efficiency"] = float(np.mean(efficiencies)) if efficiencies else None
        result["median_clearance"] = float(np.median(clearances)) if arrived else None
        result["min_clearance"] = min(clearances) if arrived else None
    result["steps_per_episode"] = float(np.mean([flight.steps for flight in flights]))
    result["steps_per_arrival"] = float(np.mean([flight.steps for flight in arrived])) if arrived else None
    for quantity in DIFFICULTY:
        if (thirds := _thirds(quantity, flights)) is not None:
            result[f"success_by_{quantity}"] = thirds
    smoothness = [(flight.steps, flight.action_change, flight.yaw_reversals) for flight in flights]
    return result | summarize_smoothness(*zip(*smoothness, strict=True))


def with_difficulty(flights: Sequence[EpisodeResult], measured: Sequence[Difficulty | None]) -> list[EpisodeResult]:
    """The episodes with the difficulty of their tasks."""
    pairs = zip(flights, measured, strict=True)
    return [flight if each is None else replace(flight, **each._asdict()) for flight, each in pairs]


def _thirds(quantity: str, flights: Sequence[EpisodeResult]) -> list[dict[str, float]] | None:
    """Success in three equal parts of the tasks, in the order of a quantity; None for few tasks without any."""
    known = sorted(
        ((value, flight) for flight in flights if (value := getattr(flight, quantity)) is not None),
        key=lambda pair: pair[0],
    )
    if len(known) < LEAST_TASKS:
        return None
    found = []
    for part in range(3):
        tasks = known[part * len(known) // 3 : (part + 1) * len(known) // 3]
        solved = [flight.outcome for _, flight in tasks].count("arrived")
        found.append({"least": tasks[0][0], "most": tasks[-1][0], "episodes": len(tasks), **wilson(solved, len(tasks))})
    return found


def _success_in(valley: int, flights: Sequence[EpisodeResult]) -> dict[str, float]:
    there = [flight.outcome for flight in flights if flight.world_seed == valley]
    return {"episodes": len(there), **wilson(there.count("arrived"), len(there))}


def _number(value: float | None, form: str) -> str:
    """A value as text, a dash where there is none."""
    return "–" if value is None else format(value, form)


def reached(result: Mapping[str, Any]) -> str:
    """The share of solved tasks, in a sentence."""
    success = {name: f"{100 * share:.1f}" for name, share in result["success"].items()}
    tasks = pluralize(result["episodes"], "fixed task")
    return f"Solved: {success['rate']} % of {tasks} ({success['low']}-{success['high']} %)."


def table(result: Mapping[str, Any]) -> str:
    """A summary as text for a person."""
    lines = [f"{'outcome':<12}{'rate':>8}   95 % interval (Wilson), {pluralize(result['episodes'], 'episode')}"]
    for name in RATES:
        rate = result[name]
        lines.append(f"{name:<12}{rate['rate']:>8.1%}   {rate['low']:.1%} – {rate['high']:.1%}")
    lines += [f"{label:<46}{_number(result[key], '.2f'):>8}" for key, label in LABELS.items() if key in result]
    lines += smoothness_lines(result.get("action_change"), result.get("yaw_reversals"))
    for valley, success in result.get("success_by_valley", {}).items():
        interval = f"{success['low']:.1%} – {success['high']:.1%}, {pluralize(success['episodes'], 'episode')}"
        lines.append(f"{f'success in valley {valley}':<46}{success['rate']:>8.1%}   {interval}")
    for quantity, (label, unit) in DIFFICULTY.items():
        for third in result.get(f"success_by_{quantity}", ()):
            told = f"success, {label} {third['least']:.2f} to {third['most']:.2f}{unit}"
            interval = f"{third['low']:.1%} – {third['high']:.1%}, {pluralize(third['episodes'], 'episode')}"
            lines.append(f"{told:<46}{third['rate']:>8.1%}   {interval}")
    return "\n".join([*lines, *(position_lines(result["position_stats"]) if "position_stats" in result else [])])


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
    """The rates of each scenario with their Wilson 95 % intervals, steps and clearance of successes, and smoothness.

    The yaw change is the mean absolute change of the yaw rate per step in rad/s, reversals are of the yaw rate. The
    success by detour, in %, is that in the third of the tasks with the least detour, in the next third and in the last.
    """
    heads = f"{'collision':>12}{'time-out':>10}{'steps per success':>19}{'clearance':>11}"
    heads += f"{'yaw change':>12}{'reversals':>11}{'by detour':>14}"
    lines = [f"{'scenario':<13}{'success':>11}  {'(95 %)':<11}{heads}"]
    for name, result in results.items():
        success, collision, time_out = (result[key] for key in RATES)
        interval = f"{100 * success['low']:.1f}–{100 * success['high']:.1f}"
        steps = _number(result["steps_per_arrival"], ".0f")
        clearance = _number(result["median_clearance"], ".2f")
        rates = f"{success['rate']:>11.1%}  {interval:<11}{collision['rate']:>12.1%}{time_out['rate']:>10.1%}"
        change = _number((result.get("action_change") or [None])[-1], ".2f")
        reversals = _number(result.get("yaw_reversals"), ".1%")
        thirds = "/".join(f"{100 * each['rate']:.0f}" for each in result.get("success_by_detour", ())) or "–"
        lines.append(f"{name:<13}{rates}{steps:>19}{clearance:>11}{change:>12}{reversals:>11}{thirds:>14}")
    return "\n".join(lines)
