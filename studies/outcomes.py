"""How many tasks end otherwise in a second evaluation of the same policy: on another processor, by another library?

    python studies/outcomes.py uavrl/policies/data/best/suite.json:static here.json
    python studies/outcomes.py a/suite.json:dense b/suite.json:dense

Prints the success of both and how many outcomes differ. A policy's last digits hang on the processor, and its episodes
amplify them: outcomes change while the rate stays what it is. p is McNemar's, exact: how often chance alone makes lost
and won as uneven.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from uavrl.errors import UavrlError
from uavrl.runs.episodes import LETTERS, outcomes_of, success_text, wilson
from uavrl_onboard.cli.process import one_sentence

TASKS = ("seed", "episodes", "env", "valleys", "planes")  # what tells whether two evaluations flew the same tasks
AMONG_PLANES = {"num_uavs": None, "processes": 1}  # likewise, where planes move with the steps of all vehicles
SUCCESS = LETTERS["arrived"]


def evaluation(place: str) -> dict[str, Any]:
    """An evaluation of ``FILE.json``, or the row of a suite in ``FILE.json:WORLD``, with its ``outcomes``."""
    path, _, world = place.rpartition(":") if not place.endswith(".json") else (place, "", "")
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        result = content[world] if world else content
        outcomes = outcomes_of(result)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UavrlError(f"Expected an evaluation in {place}, as FILE.json or FILE.json:WORLD: {error!r}.") from error
    if outcomes is None:
        raise UavrlError(f"{place} does not tell how its tasks ended, as older suites do not: evaluate again.")
    return {**result, "outcomes": outcomes}


def compared(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Successes of both, and how many outcomes differ."""
    unlike = [key for key in TASKS if one.get(key) != other.get(key)]
    if one.get("planes") and other.get("planes"):
        unlike += [key for key, default in AMONG_PLANES.items() if one.get(key, default) != other.get(key, default)]
    if unlike:
        raise UavrlError(f"Expected two evaluations of the same tasks, they differ by {' and '.join(unlike)}.")
    pairs = list(zip(one["outcomes"], other["outcomes"], strict=True))
    lost = sum(a == SUCCESS != b for a, b in pairs)
    won = sum(b == SUCCESS != a for a, b in pairs)
    return {
        "tasks": len(pairs),
        "success": [sum(pair[side] == SUCCESS for pair in pairs) for side in (0, 1)],
        "changed": sum(a != b for a, b in pairs),
        "lost": lost,
        "won": won,
        "p": float(binomtest(won, lost + won).pvalue) if lost + won else 1.0,
    }


def main() -> None:
    """Prints three lines."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("one", metavar="FILE.json[:WORLD]")
    parser.add_argument("other", metavar="FILE.json[:WORLD]")
    args = parser.parse_args()
    sides = [evaluation(args.one), evaluation(args.other)]
    found = compared(*sides)
    for place, side, arrived in zip((args.one, args.other), sides, found["success"], strict=True):
        rate = success_text(wilson(arrived, found["tasks"]), found["tasks"])
        print(f"{rate}: {place}, {side.get('processor', 'processor not recorded')}")
    share = found["changed"] / found["tasks"]
    told = f"{found['lost']} successes lost, {found['won']} won (p = {found['p']:.2f})"
    print(f"{100 * share:.1f} % of the outcomes differ: {told}")


if __name__ == "__main__":
    with one_sentence():
        main()
