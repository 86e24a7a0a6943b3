"""How often is `uavrl-compare` right, and how many tasks does it save?

    python studies/sequential.py [--orders 20] [--block 25]

Each pair of recorded evaluations of the same 500 tasks is compared in random orders of the tasks, once as recorded and
once with a coin thrown for each task that decides which policy gets which outcome, so that neither policy is better.
A pair counts as different if the interval over all 500 tasks (Newcombe 1998, paired) excludes 0.
"""

from __future__ import annotations

import argparse
import json
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from run_statistics import paired_difference

from uavrl.evaluation.sequential import stops_after
from uavrl_onboard.cli.process import one_sentence

ROOT = Path(__file__).parents[1]
TASKS = 500
FILES = ("docs/data/suite/*.json", "uavrl/policies/data/*/suite.json")


class Tally(NamedTuple):
    """Of some comparisons: the share with each verdict in %, and the mean number of tasks."""

    comparisons: int
    right: float
    wrong: float
    undecided: float
    tasks: float


def recorded() -> list[tuple[str, str]]:
    """The outcomes of all pairs of different policies in the same 500 tasks of one scenario."""
    flown: dict[str, set[str]] = {}
    for path in sorted(path for pattern in FILES for path in ROOT.glob(pattern)):
        for scenario, result in json.loads(path.read_text(encoding="utf-8")).items():
            if isinstance(result, dict) and len(result.get("outcomes", "")) == TASKS:
                flown.setdefault(scenario, set()).add(result["outcomes"])
    return [pair for scenario in sorted(flown) for pair in combinations(sorted(flown[scenario]), 2)]


def tally(pairs: list[tuple[str, str]], better: list[str | None], block: int) -> Tally:
    """Compares each pair and counts the verdicts against ``better``, where None is a pair without a difference."""
    verdicts = [(stops_after(*pair, block), truth) for pair, truth in zip(pairs, better, strict=True)]
    undecided = [comparison.better is None for comparison, _ in verdicts]
    right = [comparison.better is not None and comparison.better == truth for comparison, truth in verdicts]
    wrong = [not (each or none) for each, none in zip(right, undecided, strict=True)]
    shares = [100 * float(np.mean(each)) for each in (right, wrong, undecided)]
    return Tally(len(pairs), *shares, float(np.mean([comparison.tasks for comparison, _ in verdicts])))


def main() -> None:
    """Prints the tallies as a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--orders", type=int, default=20, help="random orders of the tasks of each pair")
    parser.add_argument("--block", type=int, default=25, help="tasks between two looks")
    args = parser.parse_args()
    rng, kinds = np.random.default_rng(0), {"different": [], "too close to tell": [], "equal by a coin": []}
    truths: dict[str, list[str | None]] = {kind: [] for kind in kinds}
    for pair in recorded():
        _, low, high = paired_difference(*pair)
        kind = "different" if low > 0 or high < 0 else "too close to tell"
        for _ in range(args.orders):
            ours, theirs = np.array([list(side) for side in pair])[:, rng.permutation(TASKS)]
            swapped = rng.random(TASKS) < 0.5
            tossed = np.where(swapped, (theirs, ours), (ours, theirs))
            for name, sides in ((kind, (ours, theirs)), ("equal by a coin", tossed)):
                kinds[name].append(("".join(sides[0]), "".join(sides[1])))
                truths[name].append(("first" if low > 0 else "second") if name == "different" else None)
    print("| pairs | comparisons | right | wrong | undecided | tasks, mean |\n|---|---|---|---|---|---|")
    for kind, pairs in kinds.items():
        count, *shares, tasks = tally(pairs, truths[kind], args.block)
        print(f"| {kind} | {count:,} | {' | '.join(f'{share:.1f}' for share in shares)} | {tasks:.0f} |")


if __name__ == "__main__":
    with one_sentence():
        main()
