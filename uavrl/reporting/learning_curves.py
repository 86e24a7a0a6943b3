"""Rates and returns over steps and episodes, from the ``episodes.csv`` of runs."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uavrl.errors import UavrlError
from uavrl.training.episodes import OUTCOMES, RATES, Episode

POINTS = 240  # of a curve: enough for a screen


def moving_mean(values: Sequence[float] | np.ndarray, window: int) -> np.ndarray:
    """Mean of the last ``window`` values (or of as many as there are), after each value.

    It is NaN where one of them is no finite number.

    Examples:
        >>> moving_mean([0.0, 1.0, 2.0, 3.0], window=2).tolist()
        [0.0, 0.5, 1.5, 2.5]
        >>> moving_mean([0.0, float("nan"), 2.0, 3.0], window=2).tolist()
        [0.0, nan, nan, 2.5]
    """
    numbers = np.asarray(values, float)
    finite = np.isfinite(numbers)
    ends = np.arange(1, len(numbers) + 1)
    count = np.minimum(ends, window)

    def summed(each: np.ndarray) -> np.ndarray:
        total = np.concatenate([[0.0], np.cumsum(each)])
        return total[ends] - total[ends - count]

    return np.where(summed(~finite) == 0, summed(np.where(finite, numbers, 0.0)) / count, np.nan)


def moving_rates(episodes: Sequence[Episode], window: int = 500) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Share of each outcome over the last ``window`` episodes (or as many as there are), after each episode.

    Args:
        episodes: as :func:`uavrl.training.episodes.read_episodes` gives them.
        window: number of episodes.

    Returns:
        Steps of training ``[E]``, and the rate ``[E]`` of each outcome.
    """
    steps = np.array([e.total_steps for e in episodes])
    return steps, {name: moving_mean([e.outcome == name for e in episodes], window) for name in OUTCOMES}


@dataclass(frozen=True)
class Curve:
    """One quantity of a group of seeds over one of the two axes.

    Attributes:
        seeds: for each seed its ``x`` and ``y``, thinned out, to its own last episode.
        x: where ``mean``, ``low`` and ``high`` stand; they end where the first seed ends. Empty for a single seed.
        mean: over the seeds.
        low: the lowest seed.
        high: the highest seed.
    """

    seeds: list[tuple[list[float], list[float]]]
    x: list[float]
    mean: list[float]
    low: list[float]
    high: list[float]


def curves(group: Sequence[Sequence[Episode]], window: int, points: int = POINTS) -> dict[str, dict[str, Curve]]:
    """Rolling success, collision and time-out rates and return of the seeds of a group.

    Args:
        group: the episodes of each seed.
        window: number of episodes that a point covers. The first points cover as many as there are, and a curve begins
            after a tenth of them: a rate over two or three episodes is noise.
        points: of each curve, at most.

    Returns:
        By quantity (``success``, ``collision``, ``time_out``, ``return``) and axis (``steps``, ``episodes``).
    """
    quantities: dict[str, list[np.ndarray]] = {name: [] for name in (*RATES, "return")}
    axes: dict[str, list[np.ndarray]] = {"steps": [], "episodes": []}
    for episodes in group:
        steps, rates = moving_rates(episodes, window)
        begin = min(max(window // 10, 1), len(episodes)) - 1
        axes["steps"].append(steps[begin:])
        axes["episodes"].append(np.arange(1, len(episodes) + 1)[begin:])
        for name, outcome in RATES.items():
            quantities[name].append(rates[outcome][begin:])
        quantities["return"].append(moving_mean([e.episode_return for e in episodes], window)[begin:])
    return {name: {axis: _curve(x, ys, points) for axis, x in axes.items()} for name, ys in quantities.items()}


def _curve(xs: list[np.ndarray], ys: list[np.ndarray], points: int) -> Curve:
    seeds = []
    for x, y in zip(xs, ys, strict=True):
        kept = np.unique(np.linspace(0, len(x) - 1, points).round().astype(int))
        seeds.append((x[kept].tolist(), _rounded(y[kept])))
    if len(xs) < 2:
        return Curve(seeds, [], [], [], [])
    start, end = max(int(x[0]) for x in xs), min(int(x[-1]) for x in xs)
    grid = np.unique(np.linspace(start, end, points).round()) if start <= end else np.array([])
    # What a seed has reached at a point is what it had after its last episode before it.
    values = np.stack([y[np.searchsorted(x, grid, side="right") - 1] for x, y in zip(xs, ys, strict=True)])
    return Curve(seeds, grid.tolist(), *(_rounded(of(values, axis=0)) for of in (np.mean, np.min, np.max)))


def _rounded(values: np.ndarray) -> list[float]:
    return np.round(values, 5).tolist()


def steps_to(episodes: Sequence[Episode], threshold: float, window: int = 500, outcome: str = "arrived") -> int | None:
    """Steps until the rate over a full window first reaches ``threshold``; ``None`` where it never does."""
    steps, rates = moving_rates(episodes, window)
    reached = np.flatnonzero(rates[outcome][window - 1 :] >= threshold)
    return int(steps[window - 1 :][reached[0]]) if len(reached) else None


def plot(runs: dict[str, Sequence[Episode]], output: Path, window: int = 500) -> None:
    """Draws success, collision and time-out rates of several runs over steps into ``output``."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    titles = {"arrived": "success", "collided": "collision", "timed_out": "time-out"}
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), sharey=True, layout="constrained")
    for axis, name in zip(axes, OUTCOMES, strict=True):
        for label, episodes in runs.items():
            steps, rates = moving_rates(episodes, window)
            axis.plot(steps / 1000, 100 * rates[name], label=label, linewidth=1.5)
        axis.set(title=titles[name], xlabel="environment steps [thousand]", ylim=(0, 100))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel(f"% of the last {window} episodes")
    axes[-1].legend(loc="upper right")
    figure.savefig(output, dpi=110)
    plt.close(figure)


def read_returns(path: Path) -> dict[str, list[float]]:
    """Episode returns that others published, by name.

    Args:
        path: a JSON file such as ``docs/data/bipedal/reference.json``: for each name a list ``episode_return``.

    Raises:
        UavrlError: when the file is missing or holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        curves = {name: entry["episode_return"] for name, entry in content.items() if isinstance(entry, dict)}
        return {name: [float(value) for value in returns] for name, returns in curves.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UavrlError(
            f"Expected a JSON file of names with a list episode_return each in {path}, it cannot be read ({error})."
        ) from error


def plot_returns(
    runs: dict[str, Sequence[Episode]], references: dict[str, Sequence[float]], output: Path, window: int = 100
) -> None:
    """Draws the mean return of the last ``window`` episodes over episodes, runs in colour and references in grey.

    Args:
        runs: episodes of each run.
        references: episode returns by name (:func:`read_returns`).
        output: the picture.
        window: number of episodes.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(8, 4.2), layout="constrained")
    for (label, returns), grey in zip(references.items(), itertools.cycle(("0.35", "0.65")), strict=False):
        axis.plot(moving_mean(returns, window), label=f"{label} (reference)", color=grey, linewidth=1.5)
    for label, episodes in runs.items():
        axis.plot(moving_mean([e.episode_return for e in episodes], window), label=label, linewidth=1.5)
    axis.set(xlabel="episodes", ylabel=f"mean return of the last {window} episodes")
    axis.grid(alpha=0.3)
    axis.legend(loc="lower right")
    figure.savefig(output, dpi=110)
    plt.close(figure)
