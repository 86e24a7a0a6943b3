"""Write the scenarios that `uavrl-evaluate suite=...` flew as a table, into a page or to the terminal.

python docs/figures/suite_table.py uavrl/policies/data/best/suite.json --page docs/deploy.md
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from uavrl.errors import UavrlError

BEGIN, END = "<!-- from suite.json -->\n", "<!-- end of suite.json -->\n"  # around the table in a page
WORLDS = {
    "static": "the default valley",
    "held_out": "ten valleys that no training used",
    "dense": "twice as many obstacles",
    "traps": "ten valleys with dead ends, into which every task leads",
    "real": "the ten valleys with all effects below",
    "real_vehicle": "mass and inertia ± 20 %, thrust ± 15 %, motors half to twice as slow, drag ± 50 %",
    "real_delay": "actions and scans each up to 0.1 s late",
    "real_sensor": "LiDAR turned and tilted by up to 3°, noise up to 3 cm, dropout up to 10 %, blind sector up to 60°; "
    "altitude wrong by up to 0.2 m, heading by up to 5°",
    "real_wind": "wind up to 2 m/s, gusts up to 0.5 m/s",
}


def table(suite: Path) -> str:
    """Return the table in Markdown; a scenario that is not in the suite has dashes."""
    try:
        found = json.loads(suite.read_text(encoding="utf-8"))
        rows = [_row(world, found.get(world)) for world in WORLDS]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UavrlError(f"Expected scenarios in {suite}, as uavrl-evaluate suite=... writes: {error!r}.") from error
    return "\n".join(["| scenario | success in % | collision in % | time-out in % |", "|---|---|---|---|", *rows, ""])


def _row(world: str, found: dict[str, dict[str, float]] | None) -> str:
    cells = ["–"] * 3 if found is None else [_percent(found[key]) for key in ("success", "collision", "time_out")]
    return f"| `{world}`: {WORLDS[world]} | {' | '.join(cells)} |"


def _percent(interval: dict[str, float]) -> str:
    rate, low, high = (100.0 * interval[key] for key in ("rate", "low", "high"))
    return f"{rate:.1f} ({low:.1f}–{high:.1f})"


def main() -> None:
    """Print the table, or put it between a page's two comments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suite", type=Path, metavar="SUITE.json")
    parser.add_argument("--page", type=Path)
    args = parser.parse_args()
    rows = table(args.suite)
    if args.page is None:
        print(rows, end="")
        return
    text = args.page.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise UavrlError(f"Expected the comments {BEGIN.strip()} and {END.strip()} in {args.page}.")
    before, after = text.partition(BEGIN)[0], text.partition(END)[2]
    args.page.write_text(f"{before}{BEGIN}{rows}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
