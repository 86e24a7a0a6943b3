"""How many time-outs a training counts that drops its open episodes at every checkpoint.

python examples/checkpoint_bias.py

A simulation: several UAVs, time-outs after ``--max-steps``, all other episodes Poisson around ``--mean-steps``. Each
checkpoint drops what is open and starts anew, as ``collector=sync`` does.
"""

from __future__ import annotations

import argparse

import numpy as np


def counted(rate: float, interval: int, args: argparse.Namespace) -> float:
    """The share of time-outs among the episodes that end, where ``rate`` of those that start will time out."""
    rng = np.random.default_rng(0)

    def start(uavs: np.ndarray) -> None:
        late[uavs] = rng.random(len(uavs)) < rate
        others = rng.poisson(args.mean_steps, len(uavs)).clip(1, args.max_steps - 1)
        length[uavs] = left[uavs] = np.where(late[uavs], args.max_steps, others)

    everyone = np.arange(args.uavs)
    late, length, left = np.zeros(args.uavs, bool), np.zeros(args.uavs, int), np.zeros(args.uavs, int)
    start(everyone)
    ended = timed_out = steps = saved = 0
    while ended < args.episodes:
        left -= left.min()
        finished = np.flatnonzero(left == 0)
        ended, timed_out, steps = (
            ended + len(finished),
            timed_out + late[finished].sum(),
            steps + length[finished].sum(),
        )
        start(finished)
        if steps - saved >= interval:
            saved = steps
            start(everyone)
    return timed_out / ended


def main() -> None:
    """Prints a row for each rate and a column for each interval."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--uavs", type=int, default=8)
    parser.add_argument("--max-steps", type=int, default=300)
    parser.add_argument("--mean-steps", type=int, default=80)
    parser.add_argument("--episodes", type=int, default=100_000)
    args = parser.parse_args()
    intervals = (20_000, 9_600, 5_000, 2_000, 1_000)
    print("true rate | checkpoint every", *(f"{interval:>7,}" for interval in intervals))
    for rate in (0.05, 0.2, 0.5):
        print(f"{rate:>26.0%}", *(f"{counted(rate, interval, args):>7.1%}" for interval in intervals))


if __name__ == "__main__":
    main()
