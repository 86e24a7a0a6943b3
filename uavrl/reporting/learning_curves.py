"""Success over steps, from the ``episodes.csv`` of runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uavrl.training.episodes import OUTCOMES, Episode


def moving_rates(episodes: Sequence[Episode], window: int = 500) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Share of each outcome over the last ``window`` episodes (or as many as there are), after each episode.

    Args:
        episodes: as :func:`uavrl.training.episodes.read_episodes` gives them.
        window: number of episodes.

    Returns:
        Steps of training ``[E]``, and the rate ``[E]`` of each outcome.
    """
    steps = np.array([e.total_steps for e in episodes])
    count = np.minimum(np.arange(1, len(episodes) + 1), window)
    rates = {}
    for outcome in OUTCOMES:
        total = np.concatenate([[0], np.cumsum([e.outcome == outcome for e in episodes])])
        rates[outcome] = (total[1:] - total[np.arange(1, len(total)) - count]) / count
    return steps, rates


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
