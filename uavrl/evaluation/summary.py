"""The rates of some episodes, as numbers and as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from uavrl.evaluation.interventions import intervention_texts, summarize_interventions
from uavrl.evaluation.position_stats import position_texts
from uavrl.evaluation.smoothness import smoothness_texts, summarize_smoothness
from uavrl.runs.episodes import LETTERS, RATES, aligned, rate_text, success_text, wilson

if TYPE_CHECKING:
    from uavrl.envs.difficulty import Difficulty
    from uavrl.evaluation.rollout import EpisodeResult

LABELS = {
    "path_efficiency": ("path efficiency (straight line over path flown)", ""),
    "median_clearance": ("median of the successes' minimum clearance", " m"),
    "min_clearance": ("least clearance of all successes", " m"),
    "mean_return": ("mean return", ""),
    "sd_return": ("standard deviation of the return", ""),
    "median_return": ("median return", ""),
    "steps_per_episode": ("steps per episode", ""),
    "steps_per_arrival": ("steps per success", ""),
}
"""What a summary's numbers are called, and their units."""
OTHERS = [name for name in RATES if name != "success"]
FEWEST = 10  # episodes in a valley whose success rate is printed
DIFFICULTY = {"detour": ("detour", ""), "spacing": ("free width", " m")}
"""Label and unit of what tells how hard a task is."""
LEAST_TASKS = 9  # of which parts are told


def summarize(flights: Sequence[EpisodeResult]) -> dict[str, Any]:
    """Rates with Wilson 95 % intervals, path efficiency and clearance, or returns, and steps.

    Path efficiency is the mean over successes; the minimum clearance (hull to nearest thing) is given as the median
    over successes and as the least of them; what has no value without them is ``None``. Several valleys are also
    counted one by one, by their seed. ``outcomes`` has a letter for each episode: success, collision or time-out.
    ``action_change`` and ``yaw_reversals`` are over all steps (:mod:`uavrl.evaluation.smoothness`), as are
    ``guard_share`` and ``guard_change`` where guards flew (:mod:`uavrl.evaluation.interventions`).

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
        if (parts := _success_by(quantity, flights)) is not None:
            result[f"success_by_{quantity}"] = parts
    smoothness = [(flight.steps, flight.action_change, flight.yaw_reversals) for flight in flights]
    guarded = [(flight.steps, flight.guard_share, flight.guard_change) for flight in flights]
    result |= summarize_smoothness(*zip(*smoothness, strict=True))
    return result | summarize_interventions(*zip(*guarded, strict=True))


def with_difficulty(flights: Sequence[EpisodeResult], measured: Sequence[Difficulty | None]) -> list[EpisodeResult]:
    """The episodes with the difficulty of their tasks."""
    pairs = zip(flights, measured, strict=True)
    return [flight if each is None else replace(flight, **each._asdict()) for flight, each in pairs]


def _success_by(quantity: str, flights: Sequence[EpisodeResult]) -> list[dict[str, float]] | None:
    """Success in parts of the tasks, in the order of a quantity; None for few tasks, or where all are alike."""
    known = sorted(
        ((value, flight.outcome) for flight in flights if (value := getattr(flight, quantity)) is not None),
        key=lambda pair: pair[0],
    )
    if len(known) < LEAST_TASKS:
        return None
    parts = [known[begin:end] for begin, end in pairwise(_bounds([round(value, 2) for value, _ in known]))]
    if len(parts) < 2:
        return None
    found = []
    for tasks in parts:
        solved = [outcome for _, outcome in tasks].count("arrived")
        found.append({"least": tasks[0][0], "most": tasks[-1][0], "episodes": len(tasks), **wilson(solved, len(tasks))})
    return found


def _bounds(values: Sequence[float], parts: int = 3) -> list[int]:
    """Where parts of sorted values begin, and the end: of about equal size, and equal values are in one part.

    Examples:
        >>> _bounds([1, 2, 3, 4, 5, 6])
        [0, 2, 4, 6]
        >>> _bounds([1, 1, 1, 1, 1, 2, 3, 4])
        [0, 5, 6, 8]
        >>> _bounds([1, 1, 1])
        [0, 3]
    """
    count, found = len(values), [0]
    ends = [i for i in range(1, count) if values[i - 1] != values[i]] + [count]
    for left in range(parts, 0, -1):
        aim = found[-1] + (count - found[-1]) / left
        if later := [end for end in ends if end > found[-1]]:
            found.append(min(later, key=lambda end: abs(end - aim)))
    return found


def _success_in(valley: int, flights: Sequence[EpisodeResult]) -> dict[str, float]:
    there = [flight.outcome for flight in flights if flight.world_seed == valley]
    return {"episodes": len(there), **wilson(there.count("arrived"), len(there))}


def number_text(value: float | None, form: str, unit: str = "") -> str:
    """A value as text, a dash where there is none."""
    return "–" if value is None else f"{value:{form}}{unit}"


def table(result: Mapping[str, Any]) -> str:
    """A summary as text for a person; its last line is the success rate."""
    lines = [(f"{name.replace('_', '-')} rate", rate_text(result[name], result["episodes"])) for name in OTHERS]
    lines += [(name, number_text(result[key], ".2f", unit)) for key, (name, unit) in LABELS.items() if key in result]
    lines += smoothness_texts(result.get("action_change"), result.get("yaw_reversals")).items()
    lines += intervention_texts(result.get("guard_share"), result.get("guard_change")).items()
    lines += position_texts(result["position_stats"]).items() if "position_stats" in result else []
    lines += _difficulty_lines(result)
    lines += _valley_lines(result.get("success_by_valley", {}))
    return "\n".join([*aligned(lines), success_text(result["success"], result["episodes"])])


def _valley_lines(valleys: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str]]:
    """The success rates of valleys with episodes enough, and the number of the others."""
    enough = {seed: found for seed, found in valleys.items() if found["episodes"] >= FEWEST}
    lines = [(f"success in valley {seed}", rate_text(found, found["episodes"])) for seed, found in enough.items()]
    few = len(valleys) - len(enough)
    return lines + ([("valleys with fewer than ten tasks", f"{few}, whose rates are in the file")] if few else [])


def _difficulty_lines(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The success rates of easy, middling and hard tasks."""
    lines = []
    for quantity, (name, unit) in DIFFICULTY.items():
        for part in result.get(f"success_by_{quantity}", ()):
            least, most = (f"{part[end]:.2f}" for end in ("least", "most"))
            values = least if least == most else f"{least} to {most}"
            lines.append((f"success, {name} {values}{unit}", rate_text(part, part["episodes"])))
    return lines
