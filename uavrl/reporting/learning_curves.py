"""Rates and returns over steps and episodes, from the ``episodes.csv`` of runs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from uavrl.runs.episodes import OUTCOMES, RATES, Episode

POINTS = 240  # of a curve: enough for a screen


def moving_mean(values: Sequence[float] | np.ndarray, window: int) -> np.ndarray:
    """Mean of the last ``window`` values (or of as many as there are), after each value."""
    total = np.concatenate([[0.0], np.cumsum(np.asarray(values, float))])
    ends = np.arange(1, len(total))
    starts = np.maximum(ends - window, 0)
    return (total[ends] - total[starts]) / (ends - starts)


def moving_rates(episodes: Sequence[Episode], window: int = 500) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Steps of training ``[E]``, and the share ``[E]`` of each outcome over the last ``window`` episodes."""
    steps = np.array([e.total_steps for e in episodes])
    return steps, {name: moving_mean([e.outcome == name for e in episodes], window) for name in OUTCOMES}


def curves(group: Sequence[Sequence[Episode]], window: int) -> dict[str, dict[str, dict[str, Any]]]:
    """Rolling success, collision and time-out rates and return of the seeds of a group."""
    axes: dict[str, list[np.ndarray]] = {"steps": [], "episodes": []}
    quantities: dict[str, list[np.ndarray]] = {name: [] for name in (*RATES, "return")}
    for episodes in group:
        steps, rates = moving_rates(episodes, window)
        begin = min(max(window // 10, 1), len(episodes)) - 1
        axes["steps"].append(steps[begin:])
        axes["episodes"].append(np.arange(1, len(episodes) + 1)[begin:])
        for name, outcome in RATES.items():
            quantities[name].append(rates[outcome][begin:])
        quantities["return"].append(moving_mean([e.episode_return for e in episodes], window)[begin:])
    return {name: {axis: _curve(xs, ys) for axis, xs in axes.items()} for name, ys in quantities.items()}


def _curve(xs: list[np.ndarray], ys: list[np.ndarray]) -> dict[str, Any]:
    kept = [np.unique(np.linspace(0, len(x) - 1, POINTS).round().astype(int)) for x in xs]
    seeds = [[x[k].tolist(), y[k].round(5).tolist()] for x, y, k in zip(xs, ys, kept, strict=True)]
    start, end = max(int(x[0]) for x in xs), min(int(x[-1]) for x in xs)
    if len(xs) < 2 or start > end:
        return {"seeds": seeds, "x": [], "mean": [], "low": [], "high": []}
    grid = np.unique(np.linspace(start, end, POINTS).round())
    # The value of a seed at a point is that of its last episode before it.
    values = np.stack([y[np.searchsorted(x, grid, side="right") - 1] for x, y in zip(xs, ys, strict=True)])
    band = {"mean": values.mean(0), "low": values.min(0), "high": values.max(0)}
    return {"seeds": seeds, "x": grid.tolist(), **{name: y.round(5).tolist() for name, y in band.items()}}


def steps_to(episodes: Sequence[Episode], threshold: float, window: int = 500) -> int | None:
    """Steps until the success rate over a full window first reaches ``threshold``; ``None`` where it never does."""
    steps, rates = moving_rates(episodes, window)
    reached = np.flatnonzero(rates["arrived"][window - 1 :] >= threshold)
    return int(steps[window - 1 :][reached[0]]) if len(reached) else None
