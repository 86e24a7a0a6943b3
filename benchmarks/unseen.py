"""Success in valleys never seen against minutes of training: `preset=td3_bc`, the controller, Stable-Baselines3's TD3.

    python benchmarks/unseen.py [--seeds 5] [--sb3-seeds 1] [--json FILE] [--figure FILE] [OVERRIDE ...]

Each run trains by itself on a quiet machine with two cores. The policy of every minute, which is that of the last
checkpoint before it, is evaluated afterwards on the same `--tasks` tasks in ten valleys that no training uses; they are
not the suite's tasks. Stable-Baselines3 trains on `uavrl/Valley-v0` with the default's reward for `--sb3-minutes`.
Minutes are those of training, compiling included; building the valleys is left out.

What is finished below `--folder` is not done again, so the command can be stopped and started.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from common import machine, sb3_td3, valley_with_prize
from torchrl.checkpoint import Checkpoint

from uavrl.errors import UavrlError
from uavrl_onboard.cli.process import one_sentence

RECIPE, SB3, CONTROLLER = "preset=td3_bc", "Stable-Baselines3's TD3", "the scripted controller"
VALLEYS = "valleys=[100,101,102,103,104,105,106,107,108,109]"


def run_here(*command: str) -> None:
    """Runs Python with one thread for each library."""
    environment = os.environ | {f"{key}_NUM_THREADS": "1" for key in ("OMP", "MKL", "OPENBLAS")}
    subprocess.run([sys.executable, *command], check=True, env=environment)


def require_same(run: Path, settings: list[str]) -> None:
    """Refuses a run that was made otherwise than it is asked for now."""
    kept = run.with_suffix(".json")
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(settings), encoding="utf-8")
    if (before := json.loads(kept.read_text(encoding="utf-8"))) != settings:
        raise UavrlError(f"{run} was made with {before}, not {settings}: choose another --folder.")


def train(seed: int, run: Path, overrides: list[str]) -> None:
    """Makes one run of ours, or goes on with it."""
    require_same(run, overrides)
    if (run / "summary.json").exists():
        return
    begun = any((run / "checkpoints").glob("checkpoint*"))
    often = ["trainer.checkpoint_interval=2500", "trainer.keep_checkpoints=1000", "logger=csv"]
    what = [f"resume={run}"] if begun else [RECIPE, f"run_dir={run}", f"seed={seed}", *often, *overrides]
    run_here("-m", "uavrl.cli.train", *what)


def train_sb3(seed: int, run: Path, minutes: float) -> None:
    """Trains Stable-Baselines3's TD3 and keeps the model of every minute."""
    require_same(run, [str(minutes)])
    if (run / "summary.json").exists():
        return
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)
    torch.set_flush_denormal(True)  # as uavrl-train does
    run.mkdir(parents=True, exist_ok=True)

    class Keep(BaseCallback):
        kept = 0

        def _on_step(self) -> bool:
            gone = (time.monotonic() - began) / 60
            if gone >= self.kept + 1:
                self.kept = int(gone)
                self.model.save(run / f"minute_{self.kept:03}.zip")
            return gone < minutes

    env = valley_with_prize()
    model = sb3_td3(env, learning_starts=10_000, seed=seed)
    began = time.monotonic()
    model.learn(10**9, callback=Keep())
    (run / "summary.json").write_text(json.dumps({"minutes": minutes}) + "\n", encoding="utf-8")


def by_minute(run: Path) -> dict[int, list[str]]:
    """What to evaluate after each minute of a run: the arguments that name its policy."""
    if models := sorted(run.glob("minute_*.zip")):
        return {int(p.stem.split("_")[1]): [f"policy={p}", "packages=[stable_baselines3]"] for p in models}
    found = {}
    for path in sorted((run / "checkpoints").glob("checkpoint*")):
        about = Checkpoint.manifest(path)["metadata"]
        if about["episodes"]:
            found[max(1, int(np.ceil(about["seconds"] / 60)))] = [f"run={run}", f"checkpoint={path}"]
    return found


def success(policy: list[str], output: Path, tasks: int) -> float:
    """The success rate in the unseen valleys; what is there already, of as many tasks, is not measured again."""
    if not output.exists() or json.loads(output.read_text(encoding="utf-8"))["episodes"] != tasks:
        where = ["env=static", VALLEYS, f"episodes={tasks}", "seed=4242", f"output={output}", "progress=false"]
        run_here("-m", "uavrl.cli.evaluate", *policy, *where)
    return float(json.loads(output.read_text(encoding="utf-8"))["success"]["rate"])


def curve(run: Path, minutes: list[int] | None, tasks: int) -> dict[int, float]:
    """Success after each minute, or after some."""
    found = by_minute(run)
    chosen = {at: policy for at, policy in found.items() if minutes is None or at in minutes or at == max(found)}
    return {at: success(policy, run / f"unseen_{at:03}.json", tasks) for at, policy in sorted(chosen.items())}


def draw(result: dict[str, Any], path: Path) -> None:
    """Success over minutes, one line for each run, and the controller's level."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 3.2), layout="constrained")
    for colour, row in enumerate(row for row in (RECIPE, SB3) if result["rows"].get(row)):
        for number, line in enumerate(result["rows"][row]):
            count = len(result["rows"][row])
            runs = f"{row}{', in one valley' if row == SB3 else ''}, {count} seed{'s' * (count > 1)}"
            label = runs if number == 0 else "_"
            axes.plot(list(map(int, line)), [100 * y for y in line.values()], color=f"C{colour}", label=label)
    axes.axhline(100 * result["controller"], color="0.4", linestyle="--", label=CONTROLLER)
    axes.set(xlabel="minutes of training", ylabel="success in unseen valleys [%]", ylim=(0, 102), xlim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend(loc="center right")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Trains and evaluates what is missing, prints the table, and writes the files that were asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path("runs/unseen"), help="where the runs go")
    parser.add_argument("--seeds", type=int, default=5, help="runs of ours")
    parser.add_argument("--sb3-seeds", type=int, default=1, help="runs of Stable-Baselines3")
    parser.add_argument("--sb3-minutes", type=float, default=10.0, help="how long one of those trains")
    parser.add_argument("--tasks", type=int, default=200, help="tasks of each evaluation")
    parser.add_argument("--minutes", type=int, nargs="+", help="which to evaluate, beside the last; all by default")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--figure", type=Path, help="also draw success over minutes")
    parser.add_argument("overrides", nargs="*", help="of uavrl-train, such as trainer.steps=60000")
    args = parser.parse_args()
    ours = [args.folder / f"best_seed{seed}" for seed in range(args.seeds)]
    theirs = [args.folder / f"sb3_seed{seed}" for seed in range(args.sb3_seeds)]
    for seed, run in enumerate(ours):
        train(seed, run, args.overrides)
    for seed, run in enumerate(theirs):
        train_sb3(seed, run, args.sb3_minutes)
    rule = ["policy=vfh", "perception=range_image", "perception.last_action=true"]
    rows = {
        RECIPE: [curve(run, args.minutes, args.tasks) for run in ours],
        SB3: [curve(run, args.minutes, args.tasks) for run in theirs],
    }
    result = {
        "rows": rows,
        "controller": success(rule, args.folder / "controller.json", args.tasks),
        "tasks": args.tasks,
        "overrides": args.overrides,
        "machine": machine(),
    }
    print(f"success in ten unseen valleys, {args.tasks} tasks; the scripted controller {result['controller']:.1%}\n")
    for row, lines in rows.items():
        for at in sorted({minute for line in lines for minute in line}):
            there = [line[at] for line in lines if at in line]
            print(f"{row:26} {at:3} min  median {median(there):.1%}  ({', '.join(f'{x:.1%}' for x in there)})")
    if args.json:
        args.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    if args.figure:
        draw(json.loads(json.dumps(result)), args.figure)


if __name__ == "__main__":
    with one_sentence():
        main()
