"""Draws how high flights were, from the files that `uavrl-evaluate` writes.

python docs/figures/altitudes.py uavrl/policies/data/best/suite.json:static uavrl/policies/data/best/suite.json:dynamic
python docs/figures/altitudes.py runs/mine/evaluation.json
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure


def shares(histogram: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The edges of a histogram's bins in metres ``[B + 1]``, and the share of all steps in each bin ``[B]``.

    Examples:
        >>> edges, share = shares({"low": 2.0, "step": 0.5, "counts": [1, 3]})
        >>> edges.tolist(), share.tolist()
        ([2.0, 2.5, 3.0], [0.25, 0.75])
    """
    counts = np.array(histogram["counts"], dtype=float)
    return histogram["low"] + histogram["step"] * np.arange(len(counts) + 1), counts / counts.sum()


def evaluation(place: str) -> tuple[str, dict[str, Any]]:
    """The name and the content of an evaluation ``FILE.json``, or of a suite's row ``FILE.json:SCENARIO``."""
    file, _, scenario = (place, "", "") if place.endswith(".json") else place.rpartition(":")
    found = json.loads(Path(file).read_text(encoding="utf-8"))
    name = Path(file).resolve().parent.name
    return (f"{name}, {scenario}", found[scenario]) if scenario else (name, found)


def main() -> None:
    """Draws the evaluations named on the command line into one picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("evaluations", nargs="+", metavar="FILE.json[:SCENARIO]")
    parser.add_argument("--ceiling", type=float, default=5.0, help="m, drawn as a line")
    parser.add_argument("--output", type=Path, default=Path("altitudes.png"))
    args = parser.parse_args()
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, result in map(evaluation, args.evaluations):
        found = result["position_stats"]
        edges, share = shares(found["altitude_histogram"])
        axes.stairs(100 * share, edges, label=name, linewidth=2)
        low, middle, high = (found["altitude"][key] for key in ("p5", "p50", "p95"))
        print(f"{name:<24}5 / 50 / 95 %: {low:.2f} / {middle:.2f} / {high:.2f} m")
    axes.axvline(args.ceiling, color="grey", linestyle=":", label="ceiling over flat ground")
    axes.set(xlabel="altitude [m]", ylabel="share of the steps [%]", xlim=(0, args.ceiling + 0.5))
    axes.legend()
    figure.savefig(args.output, dpi=120)
    print(f"Drawn to {args.output}")


if __name__ == "__main__":
    main()
