"""How often runs arrive in training in their dense valleys, while the demonstrator flies and after it.

    python studies/dense_flights.py docs/data/guided/near.csv.gz --plot docs/img/near.png
    python studies/dense_flights.py FILE.csv --add "my way s0=RUN_FOLDER"

For runs that fly in dense and in other valleys in turn, as preset=td3_bc does: of its valleys the odd ones are dense.
FILE.csv, or FILE.csv.gz, has a line for each flight: run, total_steps, outcome, world_seed. `--add` puts runs into it.
Runs whose names differ in their seed alone, "s0" at the end, are told together: a flight counts as much as any other.
"""

from __future__ import annotations

import argparse
import csv
import re
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from run_statistics import named_folder, opened

from uavrl.reporting.learning_curves import moving_mean
from uavrl.runs.episodes import rate_cell, read_episodes, wilson
from uavrl_onboard.cli.process import one_sentence

COLUMNS = ("run", "total_steps", "outcome", "world_seed")
FEWEST = 20  # flights of which a share is told
Rows = list[tuple[str, int, str, int]]


def read(path: Path) -> Rows:
    """The flights that are kept in a file."""
    if not path.is_file():
        return []
    with opened(path, "rt") as file:
        return [
            (row["run"], int(row["total_steps"]), row["outcome"], int(row["world_seed"]))
            for row in csv.DictReader(file)
        ]


def add(kept: Rows, name: str, folder: Path) -> Rows:
    """A run's flights in place of those that had its name."""
    flights = read_episodes(folder / "episodes.csv")
    others = [row for row in kept if row[0] != name]
    return [*others, *((name, each.total_steps, each.outcome, each.world_seed) for each in flights)]


def main() -> None:
    """Adds runs, prints the table and draws."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--add", nargs="+", action="extend", default=[], metavar="NAME=RUN_FOLDER")
    parser.add_argument(
        "--ranges", nargs="+", default=["0-15000", "20000-40000", "40000-60000", "60000-80000"], metavar="FROM-TO"
    )
    parser.add_argument("--window", type=int, default=60, help="flights that a point of the picture covers")
    parser.add_argument("--plot", type=Path, metavar="PNG")
    args = parser.parse_args()
    rows = read(args.file)
    for pair in args.add:
        rows = add(rows, *named_folder(pair))
    if args.add:
        with opened(args.file, "wt") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows([COLUMNS, *rows])
    runs: dict[str, dict[str, list[tuple[int, bool]]]] = {}
    for name, steps, outcome, valley in rows:
        if valley % 2:
            found = re.fullmatch(r"(.+) s(\d+)", name)
            method, seed = found.groups() if found else (name, "0")
            runs.setdefault(method, {}).setdefault(seed, []).append((steps, outcome == "arrived"))
    spans = [tuple(int(end) for end in span.split("-")) for span in args.ranges]
    heads = " | ".join(f"steps {low:,} to {high:,}" for low, high in spans)
    print(f"| success in dense valleys, % (95 % CI) | seeds | {heads} |")
    print("|---" * (2 + len(spans)) + "|")
    for method, seeds in runs.items():
        flights = [flight for seed in seeds.values() for flight in seed]
        cells = [cell([arrived for steps, arrived in flights if low < steps <= high]) for low, high in spans]
        print(f"| {method} | {len(seeds)} | {' | '.join(cells)} |")
    if args.plot:
        plot(runs, args.window, args.plot)


def cell(arrived: list[bool]) -> str:
    """Of so many flights so many arrived, with the interval; nothing of a few."""
    if len(arrived) < FEWEST:
        return "–"
    found = wilson(sum(arrived), len(arrived))
    return f"{rate_cell(found)} of {len(arrived)}"


def plot(runs: dict[str, dict[str, list[tuple[int, bool]]]], window: int, output: Path) -> None:
    """Draws each run's moving share of arrivals over steps."""
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    axes = figure.subplots()
    for number, (method, seeds) in enumerate(runs.items()):
        for index, flights in enumerate(seeds.values()):
            steps, arrived = (np.array(column) for column in zip(*flights, strict=True))
            rates = 100 * moving_mean(arrived, window)[window - 1 :]
            label = f"{method} ({len(seeds)})" if index == 0 else None
            axes.plot(steps[window - 1 :] / 1000, rates, color=f"C{number}", linewidth=1.3, label=label)
    axes.set(xlabel="environment steps [thousand]", ylabel=f"success, last {window} dense episodes [%]", ylim=(0, 100))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize="small")
    figure.savefig(output, dpi=120)


if __name__ == "__main__":
    with one_sentence():
        main()
