"""Wall-clock minutes until training succeeds: the journal's fast recipe, the default and Stable-Baselines3's TD3.

    python benchmarks/minutes.py [--seeds 5] [--sb3-seeds 1] [--json FILE] [--figure FILE]

Each row trains in the static valley, on a quiet machine with two cores, one run after the other, and is timed until
`--success` of the last `--window` training flights arrive. Runs of ours go on for `--episodes`; Stable-Baselines3's end
there. "default" is `uavrl-train` with PyTorch's own products (`collector=sync`, one update a step, multiplied by MKL).
"fast" learns from random actions, too, with what docs/results.md#training-from-random-actions lists. Stable-Baselines3
trains on `uavrl/Valley-v0` with the default's reward, networks and noise, and is given up after `--patience` minutes.
Minutes are those of training, compiling included, building the valley left out.

What is finished below `--folder` is not run again, so the command can be stopped and started; a run of ours that was
stopped is resumed, one of Stable-Baselines3 begins anew.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from common import machine, sb3_td3, valley_with_prize

from uavrl_onboard.cli.process import one_sentence

DEFAULT, FAST, SB3 = "default", "fast", "Stable-Baselines3's TD3"
OURS = {
    DEFAULT: ["collector=sync", "trainer.matmul=mkl", "algo.learning_starts=5000"],
    FAST: [
        *("reward_preset=abr_prize", "collector=async", "trainer.updates_per_step=2", "buffer.mirror=true"),
        *("algo.n_steps=3", "algo.layer_norm=true", "algo.exploration_spread=4", "algo.hidden=[256,256]"),
        *("algo.actor_lr=3e-4", "algo.learning_starts=2000"),
    ],
}
ROWS = (*OURS, SB3)


class Curve(NamedTuple):
    """The flights of one run: when each ended, and whether it arrived."""

    minutes: np.ndarray
    steps: np.ndarray
    arrived: np.ndarray

    def success(self, window: int) -> np.ndarray:
        """The share of arrivals among the last ``window`` flights, from the ``window``-th flight on."""
        return np.convolve(self.arrived, np.full(window, 1 / window), "valid")

    def reaches(self, success: float, window: int) -> tuple[float, int] | None:
        """The minutes and steps after which that share is reached first."""
        if len(self.arrived) < window:
            return None
        enough = np.flatnonzero(self.success(window) >= success - 1e-9)
        if not len(enough):
            return None
        flight = int(enough[0]) + window - 1
        return float(self.minutes[flight]), int(self.steps[flight])


def place(folder: Path, row: str, seed: int) -> Path:
    """The folder of one run."""
    return folder / f"{''.join(c if c.isalnum() else '_' for c in row)}_seed{seed}"


def read(run: Path) -> Curve:
    """The flights of a run; of ours the minutes are those that it logged."""
    with (run / "episodes.csv").open(encoding="utf-8") as file:
        flights = list(csv.DictReader(file))
    steps = np.array([int(flight["total_steps"]) for flight in flights])
    arrived = np.array([flight["outcome"] == "arrived" for flight in flights], dtype=float)
    if flights and "minutes" in flights[0]:
        return Curve(np.array([float(flight["minutes"]) for flight in flights]), steps, arrived)
    (logged,) = (run / "logs").rglob("minutes.csv")
    at, minutes = np.loadtxt(logged, delimiter=",", ndmin=2).T
    return Curve(np.interp(steps, at, minutes), steps, arrived)


def train(row: str, seed: int, run: Path, args: argparse.Namespace) -> None:
    """Makes one run, or goes on with it, in a process of its own."""
    if (run / "summary.json").exists():
        return
    if row == SB3:
        command = [__file__, "--folder", str(args.folder), "--stable-baselines", str(seed)]
        rule = [f"--{key}={getattr(args, key)}" for key in ("success", "window", "episodes", "patience")]
    elif any((run / "checkpoints").glob("checkpoint*")):
        command, rule = ["-m", "uavrl.cli.train", f"resume={run}"], []
    else:
        command = ["-m", "uavrl.cli.train", *OURS[row], f"run_dir={run}", f"seed={seed}"]
        rule = [f"trainer.window={args.window}", f"trainer.episodes={args.episodes}", "logger=csv"]
    environment = os.environ | {f"{key}_NUM_THREADS": "1" for key in ("OMP", "MKL", "OPENBLAS")}
    subprocess.run([sys.executable, *command, *rule], check=True, env=environment)


def stable_baselines(seed: int, run: Path, args: argparse.Namespace) -> None:
    """Trains Stable-Baselines3's TD3 and writes its flights as they end."""
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)
    torch.set_flush_denormal(True)  # as uavrl-train does
    run.mkdir(parents=True, exist_ok=True)
    arrived: list[bool] = []

    with (run / "episodes.csv").open("w", encoding="utf-8") as file:
        file.write("minutes,total_steps,outcome\n")

        class Watch(BaseCallback):
            def _on_step(self) -> bool:
                if not self.locals["dones"][0]:
                    return True
                info = self.locals["infos"][0]
                arrived.append(info["is_success"])
                outcome = "arrived" if info["is_success"] else "collided" if info["collided"] else "timed_out"
                file.write(f"{(time.monotonic() - began) / 60},{self.num_timesteps},{outcome}\n")
                file.flush()
                flown = len(arrived) >= args.window and np.mean(arrived[-args.window :]) >= args.success
                patient = time.monotonic() - began < 60 * args.patience
                return len(arrived) < args.episodes and not flown and patient

        env = valley_with_prize()
        model = sb3_td3(env, learning_starts=10_000, seed=seed)
        began = time.monotonic()
        model.learn(10**9, callback=Watch())
    (run / "summary.json").write_text(json.dumps({"episodes": len(arrived)}) + "\n", encoding="utf-8")


def told(runs: dict[str, list[Curve]], args: argparse.Namespace) -> dict[str, Any]:
    """Minutes and steps of each run, and the medians, where a run that never came so far counts as infinitely long."""
    result: dict[str, Any] = {"success": args.success, "window": args.window, "rows": {}, "machine": machine()}
    for row, curves in runs.items():
        reached = [curve.reaches(args.success, args.window) for curve in curves]
        minutes = [float("inf") if at is None else at[0] for at in reached]
        result["rows"][row] = {
            "minutes": [None if at is None else at[0] for at in reached],
            "steps": [None if at is None else at[1] for at in reached],
            "median_minutes": None if median(minutes) == float("inf") else median(minutes),
        }
    fast, default = (result["rows"].get(row, {}).get("median_minutes") for row in (FAST, DEFAULT))
    result["fast_vs_default"] = fast / default if fast and default else None
    return result


def draw(runs: dict[str, list[Curve]], window: int, path: Path) -> None:
    """Success over minutes, one line for each run."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 3.2), layout="constrained")
    for colour, (row, curves) in enumerate(runs.items()):
        for seed, curve in enumerate(curve for curve in curves if len(curve.arrived) >= window):
            first = np.cumsum(curve.arrived[: window - 1]) / np.arange(1, window)  # of all flights, as long as few
            success = np.concatenate([first, curve.success(window)])
            label = f"{row}, {len(curves)} seeds" if len(curves) > 1 else row
            label = label if seed == 0 else "_"  # matplotlib leaves out of the legend what begins so
            axes.plot(curve.minutes, 100 * success, color=f"C{colour}", label=label, linewidth=1.2)
    axes.set(xlabel="minutes", ylabel=f"success of the last {window} flights [%]", ylim=(0, 100), xlim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Trains what is missing, prints the table, and writes the files that were asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path("runs/minutes"), help="where the runs go")
    parser.add_argument("--seeds", type=int, default=5, help="runs of each row of ours")
    parser.add_argument("--sb3-seeds", type=int, default=1, help="runs of Stable-Baselines3")
    parser.add_argument("--patience", type=float, default=40.0, help="minutes after which one of those is given up")
    parser.add_argument("--success", type=float, default=0.8, help="share of arrivals that is waited for")
    parser.add_argument("--window", type=int, default=200, help="training flights that the share covers")
    parser.add_argument("--episodes", type=int, default=2000, help="most flights of a run")
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=ROWS, help="which to run")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--figure", type=Path, help="also draw success over minutes")
    parser.add_argument("--stable-baselines", type=int, metavar="SEED", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.stable_baselines is not None:
        stable_baselines(args.stable_baselines, place(args.folder, SB3, args.stable_baselines), args)
        return
    seeds = {row: args.sb3_seeds if row == SB3 else args.seeds for row in args.rows}
    for seed in range(max(seeds.values())):
        for row in args.rows:
            if seed < seeds[row]:
                train(row, seed, place(args.folder, row, seed), args)
    runs = {row: [read(place(args.folder, row, seed)) for seed in range(seeds[row])] for row in args.rows}
    result = told(runs, args)
    print(f"minutes until {args.success:.0%} of the last {args.window} training flights arrive\n")
    for row, found in result["rows"].items():
        each = ", ".join("never" if value is None else f"{value:.1f}" for value in found["minutes"])
        middle = found["median_minutes"]
        print(f"{row:26} median {'never' if middle is None else f'{middle:.1f}'}  ({each})")
    if args.json:
        args.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    if args.figure:
        draw(runs, args.window, args.figure)


if __name__ == "__main__":
    with one_sentence():
        main()
