"""Draws the learning curves of runs and prints when they pass a success rate.

python examples/learning_curves.py runs/a runs/b --output curves.png
python examples/learning_curves.py runs/walker --window 100 --reference docs/data/bipedal/reference.json
"""

from __future__ import annotations

import argparse
from pathlib import Path

from uavrl.reporting.learning_curves import moving_rates, plot, plot_returns, read_returns, steps_to
from uavrl.training.episodes import Episode, read_episodes


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
    main()
