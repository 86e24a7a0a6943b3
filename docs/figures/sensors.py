"""Draws the success of a policy with each sensor in each world, from what ``studies/sensors.py`` wrote.

python docs/figures/sensors.py docs/data/sensors.json --output docs/img/sensors.png
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uavrl.envs.sensors import SENSORS
from uavrl.errors import UavrlError

WORLDS = {"static": "valleys", "forest": "forest", "rooms": "rooms"}
GUARDS = ("no guards", "guards")


def grid(rows: list[dict[str, Any]], policy: str = "best") -> np.ndarray:
    """Success in %, ``[sensors, worlds * guards]``, of a policy's row with most tasks; NaN where there is none."""
    cells = np.full((len(SENSORS), len(WORLDS) * len(GUARDS)), np.nan)
    drawn = [row for row in rows if row["policy"] == policy and row["world"] in WORLDS]
    for row in sorted(drawn, key=lambda each: each["episodes"]):
        column = list(WORLDS).index(row["world"]) * len(GUARDS) + int(row["guards"] != "none")
        cells[list(SENSORS).index(row["sensor"]), column] = 100 * row["success"]["rate"]
    return cells


def main() -> None:
    """Draws the file named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", type=Path, metavar="FILE")
    parser.add_argument("--policy", default="best")
    parser.add_argument("--output", type=Path, default=Path("sensors.png"))
    args = parser.parse_args()
    try:
        cells = grid(json.loads(args.rows.read_text(encoding="utf-8")), args.policy)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UavrlError(f"Expected rows in {args.rows}, as of studies/sensors.py: {error!r}.") from error
    flown = ~np.isnan(cells)
    columns = [f"{world}\n{guard}" for world in WORLDS.values() for guard in GUARDS]
    names, heads = (
        [name for name, some in zip(all_of, flown.any(axis), strict=True) if some]
        for all_of, axis in ((list(SENSORS), 1), (columns, 0))
    )
    cells = cells[flown.any(1)][:, flown.any(0)]
    figure = Figure(figsize=(7, 0.5 + 0.45 * len(names)), layout="constrained")
    axes = figure.subplots()
    axes.imshow(cells, cmap="RdYlGn", vmin=0, vmax=100, aspect="auto", alpha=0.75)
    for (sensor, column), rate in np.ndenumerate(cells):
        axes.text(column, sensor, "–" if np.isnan(rate) else f"{rate:.1f}", ha="center", va="center")
    axes.set_yticks(range(len(names)), names)
    axes.set_xticks(range(len(heads)), heads)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    figure.savefig(args.output, dpi=100)
    print(f"Drawn to {args.output}")


if __name__ == "__main__":
    main()
