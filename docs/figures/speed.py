"""Draws success and time to the goal against the limit of speed, from what ``uavrl-evaluate`` wrote at each limit.

python docs/figures/speed.py docs/data/rivals/at_speed.json --output docs/img/speed.png

The file has, for each policy and each limit in m/s, the result of its evaluation. With ``--table`` the script prints
them as a table in Markdown. ``--add NAME LIMIT FILE`` puts an evaluation into the file, without its single flights.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uavrl.envs.navigation import CONTROL_RATE
from uavrl.runs.episodes import rate_cell

Found = dict[str, dict[str, dict[str, Any]]]
KEPT = ("episodes", "success", "collision", "time_out", "outcomes", "steps_per_arrival", "seed", "overrides", "commit")


def slim(evaluation: dict[str, Any]) -> dict[str, Any]:
    """What the file keeps of an evaluation, with the mean speed of its flights in m/s."""
    flights = evaluation["flights"]
    flown, steps = (sum(flight[key] for flight in flights) for key in ("flown", "steps"))
    kept = {key: evaluation[key] for key in KEPT if key in evaluation}
    kept["success"] = {key: round(value, 6) for key, value in kept["success"].items()}
    for key in ("collision", "time_out"):
        kept[key] = {"rate": kept[key]["rate"]}
    return kept | {"mean_speed": round(flown / steps * CONTROL_RATE, 2)}


def seconds(result: dict[str, Any]) -> float:
    """Mean time of the successes in s."""
    return float(result["steps_per_arrival"]) / CONTROL_RATE


def limits(results: dict[str, Any]) -> list[str]:
    """The limits of a policy's results, the lowest first."""
    return sorted(results, key=float)


def table(found: Found) -> Iterator[str]:
    """A row for each policy, a column for each limit: success with its interval, and the time of the successes."""
    known = limits({limit: None for results in found.values() for limit in results})
    yield f"| success in % (95 % CI); time to the goal in s | {' | '.join(f'{limit} m/s' for limit in known)} |"
    yield "|---" * (len(known) + 1) + "|"
    for name, results in found.items():
        cells = [
            f"{rate_cell(results[limit]['success'])}; {seconds(results[limit]):.1f}" if limit in results else "–"
            for limit in known
        ]
        yield f"| {name} | {' | '.join(cells)} |"


def draw(found: Found, output: Path) -> None:
    """Writes the picture."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    above, beside = figure.subplots(1, 2)
    offsets = np.linspace(-0.1, 0.1, len(found)) if len(found) > 1 else [0.0]
    for offset, (name, results) in zip(offsets, found.items(), strict=True):
        known = limits(results)
        at = np.array([float(limit) for limit in known]) + offset
        rates = [[100 * results[limit]["success"][key] for limit in known] for key in ("rate", "low", "high")]
        rate, low, high = np.array(rates)
        style = {"marker": "o", "markersize": 4, "linewidth": 1}
        above.errorbar(at, rate, yerr=(rate - low, high - rate), capsize=2, label=name, **style)
        beside.plot(at, [seconds(results[limit]) for limit in known], **style)
    above.set(ylabel="success [%]", ylim=(0, 103))  # so that a dot at 100 is whole
    beside.set(ylabel="time to the goal [s]", ylim=(0, None))
    for axes in (above, beside):
        axes.set(xlabel="limit of each component of the velocity [m/s]")
        axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper")
    figure.savefig(output, dpi=110)


def main() -> None:
    """Draws the file, prints its table, or adds an evaluation to it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--table", action="store_true", help="print a table in place of the picture")
    parser.add_argument("--add", nargs=3, metavar=("NAME", "LIMIT", "FILE"), help="add an evaluation to the file")
    parser.add_argument("--output", type=Path, default=Path("speed.png"))
    args = parser.parse_args()
    found: Found = json.loads(args.file.read_text(encoding="utf-8")) if args.file.exists() else {}
    if args.add:
        name, limit, file = args.add
        found.setdefault(name, {})[limit] = slim(json.loads(Path(file).read_text(encoding="utf-8")))
        args.file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    elif args.table:
        print("\n".join(table(found)))
    else:
        draw(found, args.output)
        print(f"Drawn to {args.output}")


if __name__ == "__main__":
    main()
