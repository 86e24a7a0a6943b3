"""End-to-end training speed beside what a user would otherwise install, and the memory that it takes.

Run `python benchmarks/train.py [--json FILE]`. Every row trains TD3 on the static valley: full VLP-16 scans (28,928
rays) of 4 m range, the same reduction and frames, states of 105, networks 400-300, batches of 100, one update for each
step, actor and targets every second update, a replay buffer for a million. "uavrl" is the default experiment of
`uavrl-train`, 8 UAVs in one world, through its real trainer, its updates compiled where there is a C++ compiler;
"captured" is what it does elsewhere. The Stable-Baselines3 rows fly one UAV in `uavrl:uavrl/Valley-v0`, 8 UAVs in one
world by `uavrl.envs.sb3.ValleyVecEnv`, and one UAV with its rays cast by PyBullet's `rayTestBatch`.

Each row runs in a process of its own with the same number of threads, one after another, in rounds; medians count.
With `collector=async` a second process flies meanwhile: it needs a second core. Random steps and the first updates, and
with them compilation, are left out. The clock counts updates, one for each step learned from: steps themselves come in
bursts, when flights end. Peak memory is that of the row's process and of those that fly for it. On Linux.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import compose, machine, sb3_td3

from uavrl_onboard.cli.process import one_sentence

RANDOM_STEPS = 1024  # of the uavrl rows; flights are learned from when they end, so that 8 UAVs need some to get going
FEW_RANDOM_STEPS = 200  # of the others: two batches


class EnoughError(Exception):
    """Ends a training that was measured for long enough."""


@dataclass
class Clock:
    """Steps per second, each with its update, from the ``start``-th on and for ``steps`` of them."""

    start: int
    steps: int
    begin: float | None = None
    speed: float = 0.0  # steps per second
    peak_rss: float = 0.0  # MiB

    def tick(self, steps: int) -> None:
        """Takes note of the steps made so far.

        Raises:
            EnoughError: when all are made.
        """
        if self.begin is None and steps >= self.start:
            self.start, self.begin = steps, time.perf_counter()
        if self.begin is not None and steps >= self.start + self.steps:
            self.speed = (steps - self.start) / (time.perf_counter() - self.begin)
            self.peak_rss = peak_rss()
            raise EnoughError


def peak_rss() -> float:
    """The most MiB that this process and those that fly for it have held; what they share counts in each."""
    pids = ["self", *(str(child.pid) for child in multiprocessing.active_children())]
    status = [line for pid in pids for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()]
    return sum(int(line.split()[1]) for line in status if line.startswith("VmHWM:")) / 1024


# ------------------------------------------------------------------ the rows


def uavrl_train(overrides: list[str], steps: int, warm_up: int, threads: int) -> Clock:
    """The default experiment of `uavrl-train`, but for ``overrides``."""
    from uavrl_onboard.cli.process import configure_logging

    configure_logging()  # as the command does, before TorchRL is imported
    from uavrl.training import build, run

    clock = Clock(warm_up, steps)

    class Watched(build.ActorCriticStepper):
        def step(self, *args: Any) -> Any:
            clock.tick(self.updates)
            return super().step(*args)

    build.ActorCriticStepper = Watched  # type: ignore[misc]
    with tempfile.TemporaryDirectory() as folder:
        config = compose(
            f"run_dir={folder}/run",
            *overrides,
            f"trainer.threads={threads}",
            f"algo.learning_starts={RANDOM_STEPS}",
            "trainer.progress=false",
        )
        _until_enough(lambda: run.train(config, run.create_run(config)))
    return clock


def stable_baselines(make_env: Callable[[int], Any], steps: int, warm_up: int, threads: int) -> Clock:
    """TD3 of Stable-Baselines3, told to make the same updates."""
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(threads)
    torch.set_flush_denormal(True)  # as uavrl-train does
    clock = Clock(FEW_RANDOM_STEPS + warm_up, steps)

    class Watch(BaseCallback):
        def _on_step(self) -> bool:
            clock.tick(self.num_timesteps)
            return True

    model = sb3_td3(make_env(threads), learning_starts=FEW_RANDOM_STEPS, seed=0)
    _until_enough(lambda: model.learn(10**9, callback=Watch()))
    return clock


def valley(_: int) -> Any:
    """`uavrl/Valley-v0`."""
    import gymnasium

    return gymnasium.make("uavrl:uavrl/Valley-v0")


def vehicles(_: int) -> Any:
    """The same with 8 UAVs in one world."""
    from uavrl.envs.sb3 import ValleyVecEnv

    return ValleyVecEnv(8)


def pybullet_valley(threads: int) -> Any:
    """The same with PyBullet's rays."""
    from pybullet_rays import PyBulletValleyEnv

    return PyBulletValleyEnv(threads)


def _until_enough(train: Callable[[], Any]) -> None:
    try:
        train()
    except EnoughError:
        return
    raise SystemExit("The training ended before it was measured.")


Run = Callable[[int, int, int], Clock]
OURS, CAPTURED, ASYNC = "uavrl", "uavrl, trainer.execution=captured", "uavrl, collector=async"
SB3, SB3_EIGHT = "Stable-Baselines3", "Stable-Baselines3, 8 UAVs in one world"
SB3_PYBULLET = "Stable-Baselines3 + PyBullet's rays"
ROWS: dict[str, Run] = {
    OURS: partial(uavrl_train, []),
    CAPTURED: partial(uavrl_train, ["trainer.execution=captured"]),
    ASYNC: partial(uavrl_train, ["collector=async"]),
    SB3: partial(stable_baselines, valley),
    SB3_EIGHT: partial(stable_baselines, vehicles),
    SB3_PYBULLET: partial(stable_baselines, pybullet_valley),
}
SHARES = {SB3: 0.3, SB3_EIGHT: 0.3, SB3_PYBULLET: 0.05}  # of the steps: they are slow, and their steps come one by one


# ------------------------------------------------------------------ one process for each


def run_row(name: str, steps: int, warm_up: int, threads: int) -> None:
    """Runs one row in this process and prints its numbers."""
    clock = ROWS[name](steps, warm_up, threads)
    print(json.dumps({"steps_per_second": clock.speed, "peak_rss_mib": clock.peak_rss}))


def in_own_process(name: str, steps: int, warm_up: int, threads: int) -> dict[str, float]:
    """Runs one row in a new process."""
    counts = ["--steps", str(steps), "--warm-up", str(warm_up), "--threads", str(threads)]
    environment = os.environ | {f"{key}_NUM_THREADS": str(threads) for key in ("OMP", "MKL", "OPENBLAS")}
    command = [sys.executable, __file__, "--row", name, *counts]
    result = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if result.returncode:
        raise SystemExit(f"{name} failed:\n{result.stderr}")
    return json.loads(result.stdout.splitlines()[-1])


def measure(names: list[str], args: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Returns the medians of each row."""
    found: dict[str, list[dict[str, float]]] = {name: [] for name in names}
    for turn in range(args.repeats):
        for name in names:
            share = SHARES.get(name, 1.0)
            counts = [max(int(share * count), 1) for count in (args.steps, args.warm_up)]
            found[name].append(in_own_process(name, counts[0], counts[1], args.threads))
            print(f"round {turn + 1}, {name}: {found[name][-1]['steps_per_second']:.1f} steps/s", file=sys.stderr)
    return {
        name: {key: float(np.median([row[key] for row in rows])) for key in rows[0]} for name, rows in found.items()
    }


def main() -> None:
    """Measures, prints the table, and writes the JSON file if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--repeats", type=int, default=3, help="rounds")
    parser.add_argument("--steps", type=int, default=10_000, help="measured steps; of the slow rows a share")
    parser.add_argument("--warm-up", type=int, default=1000, help="steps with updates before; of the slow rows a share")
    parser.add_argument("--threads", type=int, default=1, help="threads of each row, PyBullet's ray casting included")
    parser.add_argument("--skip-async", action="store_true", help="leave out the row that needs a second core")
    parser.add_argument("--row", choices=list(ROWS), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.row:
        run_row(args.row, args.steps, args.warm_up, args.threads)
        return
    about = machine()
    rows = measure([name for name in ROWS if not (args.skip_async and name == ASYNC)], args)
    chosen = ASYNC if ASYNC in rows else OURS
    ours = rows[chosen]["steps_per_second"]
    result = {
        "row": chosen,
        "steps_per_second": ours,
        "vs_sb3": ours / rows[SB3]["steps_per_second"],
        "vs_sb3_eight": ours / rows[SB3_EIGHT]["steps_per_second"],
        "vs_sb3_pybullet": ours / rows[SB3_PYBULLET]["steps_per_second"],
        "threads": args.threads,
        "rows": rows,
        "machine": about,
    }
    print(f"{args.threads} threads, {about['cpu']}, median of {args.repeats} rounds of {args.steps} steps")
    print("(" + ", ".join(f"{name}: {share:.0%} of them" for name, share in SHARES.items()) + ")\n")
    print(f"{'':38}{'steps/s':>10}{'peak MiB':>10}   {chosen} is")
    for name, row in rows.items():
        speed = row["steps_per_second"]
        print(f"{name:38}{speed:10.1f}{row['peak_rss_mib']:10.0f}{ours / speed:8.2f} times as fast")
    if args.json:
        args.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
