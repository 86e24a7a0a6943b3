"""Whether one policy arrives more often than another: the difference of their rates, with its 95 % interval.

    python studies/differences.py FILE.json:WORLD ... --less FILE.json:WORLD ...

Each FILE is one that `uavrl-evaluate suite=... output=FILE` writes, or several such put together under their names.
The tasks of all that is named on a side count as one sample: the rates differ by Newcombe (1998), method 10.
That tells of these trainings. What another training would bring is told where both sides are five or more of them:
the difference of the interquartile means, with an interval by resampling seeds (Agarwal et al. 2021).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from run_statistics import FEWEST, difference, difference_of_rates

from uavrl.errors import UavrlError, reason
from uavrl.runs.episodes import success_text, wilson
from uavrl_onboard.cli.process import one_sentence


def arrivals(place: str) -> tuple[int, int]:
    """How many of how many tasks arrived, in ``FILE.json:WORLD``."""
    path, _, world = place.rpartition(":")
    try:
        worlds = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UavrlError(f"Expected FILE.json:WORLD, got {place!r}: {reason(error)}.") from error
    if world not in worlds:
        raise UavrlError(f"Expected a world of {path}, got {world!r}: it tells of {'; '.join(worlds)}.")
    tasks = worlds[world]["episodes"]
    return round(worlds[world]["success"]["rate"] * tasks), tasks


def told(rate: tuple[float, float, float]) -> str:
    """A difference in points, with its interval."""
    return "{:+.1f} points ({:+.1f} to {:+.1f})".format(*rate)


def main() -> None:
    """Prints both rates and by how much they differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("these", nargs="+", metavar="FILE.json:WORLD")
    parser.add_argument(
        "--less", nargs="+", action="extend", required=True, metavar="FILE.json:WORLD", help="what is taken off"
    )
    args = parser.parse_args()
    sides = [[arrivals(place) for place in side] for side in (args.these, args.less)]
    rates = [wilson(*map(sum, zip(*side, strict=True))) for side in sides]
    for side, rate in zip(sides, rates, strict=True):
        print(f"{success_text(rate, sum(tasks for _, tasks in side))}, trainings: {len(side)}")
    one, other = ({end: 100 * value for end, value in rate.items()} for rate in rates)
    print(f"difference {told(difference_of_rates(one, other))}")
    if min(map(len, sides)) >= FEWEST:
        seeds = [np.array([100 * arrived / tasks for arrived, tasks in side]) for side in sides]
        print(f"difference over trainings {told(difference(*seeds))}")


if __name__ == "__main__":
    with one_sentence():
        main()
