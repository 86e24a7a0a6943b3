"""Draws the learning curves of runs and prints when they pass a success rate.

python studies/learning_curves.py runs/a runs/b --output curves.png
python studies/learning_curves.py runs/walker --window 100 --reference docs/data/bipedal/reference.json
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from uavrl.errors import UavrlError
from uavrl.reporting.learning_curves import moving_mean, moving_rates, steps_to
from uavrl.runs.episodes import OUTCOMES, Episode, read_episodes
from uavrl_onboard.cli.process import one_sentence


def plot(runs: dict[str, list[Episode]], output: Path, window: int) -> None:
    """Draws success, collision and time-out rates of several runs over steps."""
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
    """Episode returns that others published: for each name in a JSON file a list ``episode_return``."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return {
            name: [float(value) for value in entry["episode_return"]]
            for name, entry in content.items()
            if name != "about"
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UavrlError(f"Expected names with a list episode_return each in {path}: {error}.") from error


def plot_returns(runs: dict[str, list[Episode]], references: dict[str, list[float]], output: Path, window: int) -> None:
    """Draws the mean return of the last episodes over episodes, runs in colour and references in grey."""
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


def mean_return(episodes: list[Episode], outcome: str) -> str:
    """Mean return of the episodes that ended so."""
    returns = [e.episode_return for e in episodes if e.outcome == outcome]
    return f"{sum(returns) / len(returns):.0f}" if returns else "–"


def main() -> None:
    """Reads the runs named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--output", type=Path, default=Path("learning_curves.png"))
    parser.add_argument("--threshold", type=float, default=0.6)
    parser.add_argument("--window", type=int, default=500)
    parser.add_argument("--until", type=int, default=None, help="leave out episodes after this many steps")
    parser.add_argument("--reference", type=Path, help="draw returns over episodes beside those of a JSON file")
    args = parser.parse_args()
    runs = {}
    for run in args.runs:
        episodes = read_episodes(run / "episodes.csv")
        runs[run.name] = [e for e in episodes if args.until is None or e.total_steps <= args.until]
    print(f"rates and mean returns over the last {args.window} episodes")
    heads = f"{'success':>9}{'collision':>11}{'time-out':>10}{'return if arrived':>19}{'timed out':>11}"
    print(f"{'run':<28}{'episodes':>9}{'steps':>9}{heads}   steps to {args.threshold:.0%}")
    for name, episodes in runs.items():
        steps, rates = moving_rates(episodes, args.window)
        last = "".join(f"{rates[o][-1]:>{w}.1%}" for o, w in (("arrived", 9), ("collided", 11), ("timed_out", 10)))
        last += f"{mean_return(episodes[-args.window :], 'arrived'):>19}"
        last += f"{mean_return(episodes[-args.window :], 'timed_out'):>11}"
        reached = steps_to(episodes, args.threshold, args.window)
        print(f"{name:<28}{len(episodes):>9,}{steps[-1]:>9,}{last}   {'–' if reached is None else f'{reached:,}'}")
    if args.reference is None:
        plot(runs, args.output, args.window)
    else:
        plot_returns(runs, read_returns(args.reference), args.output, args.window)
    print(f"Drawn to {args.output}")


if __name__ == "__main__":
    with one_sentence():
        main()
