"""Draws success in each world, with its interval, from the files that ``uavrl-evaluate suite=... output=FILE`` writes.

python docs/figures/scenarios.py "vfh=docs/data/suite/vfh_turning.json" "best=uavrl/policies/data/best/suite.json"

A name that is given twice has the worlds of both files. With ``--table`` it prints them as a table in Markdown; an
asterisk is at rates of fewer tasks than the most.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uavrl.errors import UavrlError

Found = dict[str, dict[str, float]]


def read(pair: str) -> tuple[str, Found]:
    """A policy's name, and its success in each world: ``rate``, ``low`` and ``high``, of so many ``episodes``."""
    name, _, path = pair.rpartition("=")
    try:
        worlds = json.loads(Path(path).read_text(encoding="utf-8"))
        told = {world: {**found["success"], "episodes": found["episodes"]} for world, found in worlds.items()}
        return name or Path(path).stem, told
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UavrlError(f"Expected worlds with a success each in {path}, as of uavrl-evaluate: {error!r}.") from error


def table(policies: Sequence[tuple[str, Found]], worlds: Sequence[str]) -> str:
    """A row for each policy, a column for each world; a dash where it has not been evaluated."""
    most = max(each["episodes"] for _, found in policies for each in found.values())

    def cell(each: dict[str, float] | None) -> str:
        if each is None:
            return "–"
        rate, low, high = (100 * each[key] for key in ("rate", "low", "high"))
        mark = "" if each["episodes"] == most else "\\*"
        return f"{rate:.1f}{mark} ({low:.1f}–{high:.1f})"

    rows = [[name, *(cell(found.get(world)) for world in worlds)] for name, found in policies]
    heads = [["success in %", *(f"`{world}`" for world in worlds)], ["---"] * (len(worlds) + 1)]
    return "\n".join(f"| {' | '.join(row)} |" for row in heads + rows)


def main() -> None:
    """Draws the files named on the command line into one picture, or prints their table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policies", nargs="+", metavar="NAME=FILE")
    parser.add_argument("--worlds", nargs="+", default=["static", "held_out", "dynamic", "dense"])
    parser.add_argument("--table", action="store_true", help="print a table in place of the picture")
    parser.add_argument("--output", type=Path, default=Path("scenarios.png"))
    args = parser.parse_args()
    named: dict[str, Found] = {}
    for name, found in map(read, args.policies):
        named[name] = named.get(name, {}) | found
    policies = list(named.items())
    unknown = [world for world in args.worlds if not any(world in found for _, found in policies)]
    if unknown:
        raise UavrlError(f"Expected worlds that a file tells of, got {', '.join(unknown)}: leave them out of --worlds.")
    if args.table:
        print(table(policies, args.worlds))
        return
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    axes = figure.subplots()
    offsets = np.linspace(-0.3, 0.3, len(policies)) if len(policies) > 1 else [0.0]
    for offset, (name, found) in zip(offsets, policies, strict=True):
        worlds = [world for world in args.worlds if world in found]
        rate, low, high = (100 * np.array([found[world][key] for world in worlds]) for key in ("rate", "low", "high"))
        at = [args.worlds.index(world) + offset for world in worlds]
        axes.errorbar(at, rate, yerr=(rate - low, high - rate), fmt="o", capsize=3, label=name)
    axes.set_xticks(range(len(args.worlds)), [world.replace("_", " ") for world in args.worlds])
    axes.set(ylabel="success [%]", xlim=(-0.5, len(args.worlds) - 0.5), ylim=(0, 103))  # so that a dot at 100 is whole
    axes.grid(axis="y", alpha=0.3)
    figure.legend(loc="outside right upper")
    figure.savefig(args.output, dpi=120)
    print(f"Drawn to {args.output}")


if __name__ == "__main__":
    main()
