"""How long `make train` takes, and how good its policies are: five seeds, one after the other.

    python benchmarks/make_train.py [--seeds 5] [--cached] [--tasks 500] [--json FILE]

Each seed runs `make train` as a newcomer does, set-up done: training, then 100 tasks in unseen valleys and the replay
beside them. The total is the wall-clock time of all that. Without `--cached` each seed begins with an empty cache, so
that the total includes building the valleys; with it the valleys are built once, before the clock starts. Then, not
timed, the policy is evaluated in the suite's `held_out` and `dense`, which nothing was chosen by. Run it on a quiet
machine with two cores, where `make setup` was run.

What is finished below `--folder` is not run again, so the command can be stopped and started.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

from common import machine

from uavrl_onboard.cli.process import one_sentence

ROOT = Path(__file__).parents[1]
SCENARIOS = ("held_out", "dense")
TIMES = "make_train.json"  # in a run's folder


def timed(command: list[str], cache: Path) -> tuple[float, float]:
    """Wall-clock and processor seconds of a command and all that it started."""
    began, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, cwd=ROOT, env=os.environ | {"UAVRL_CACHE": str(cache)})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.monotonic() - began, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def make_train(seed: int, run: Path, args: argparse.Namespace) -> None:
    """Runs `make train` once, and notes how long it took."""
    if (run / TIMES).exists():
        return
    shutil.rmtree(run, ignore_errors=True)
    cache = args.folder / ("cache" if args.cached else f"cache_seed{seed}")
    if not args.cached:
        shutil.rmtree(cache, ignore_errors=True)
    overrides = " ".join([f"seed={seed}", *args.overrides])
    wall, cpu = timed(["make", "train", f"RUN={run}", f"ARGS={overrides}"], cache)
    (run / TIMES).write_text(json.dumps({"seconds": wall, "cpu_seconds": cpu}) + "\n", encoding="utf-8")


def build_valleys(folder: Path) -> None:
    """Fills the cache with the valleys that `make train` builds."""
    code = (
        "from uavrl.config import compose, validate; from uavrl.envs.world import map_places, WorldConfig; "
        "world = validate(compose('preset=dagger')).env.world; map_places(world); "
        "map_places(WorldConfig(seeds=tuple(range(100, 110))))"
    )
    timed([sys.executable, "-c", code], folder / "cache")


def evaluate(run: Path, args: argparse.Namespace) -> dict[str, float]:
    """The success rate of each scenario in percent; what was evaluated before is not evaluated again."""
    folder = run / "suite_of_benchmark"
    command = [sys.executable, "-m", "uavrl.cli.evaluate", f"run={run}", f"suite=[{','.join(SCENARIOS)}]"]
    subprocess.run([*command, f"episodes={args.tasks}", f"output={folder}"], check=True, cwd=ROOT)
    results = {name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in SCENARIOS}
    return {name: 100.0 * result["success"]["rate"] for name, result in results.items()}


def row(seed: int, run: Path, args: argparse.Namespace) -> dict[str, Any]:
    """What is known of one seed."""
    times = json.loads((run / TIMES).read_text(encoding="utf-8"))
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    return {
        "seed": seed,
        "minutes": times["seconds"] / 60,
        "cpu_minutes": times["cpu_seconds"] / 60,
        "training_minutes": summary["minutes"],
        "steps": summary["steps"],
        "updates": summary["updates"],
        **evaluate(run, args),
    }


def main() -> None:
    """Runs what is missing, prints the table, and writes the file that was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path("runs/make_train"), help="where the runs go")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--cached", action="store_true", help="build the valleys before the clock starts")
    parser.add_argument("--tasks", type=int, default=500, help="of each scenario")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("overrides", nargs="*", help="of the training, as KEY=VALUE")
    args = parser.parse_args()
    args.folder = args.folder.absolute()
    args.folder.mkdir(parents=True, exist_ok=True)
    if args.cached:
        build_valleys(args.folder)
    rows = []
    for seed in range(args.seeds):
        run = args.folder / f"{'cached' if args.cached else 'first'}_seed{seed}"
        make_train(seed, run, args)
        rows.append(row(seed, run, args))
    columns = ("minutes", "cpu_minutes", "training_minutes", *SCENARIOS)
    middle = {name: median(each[name] for each in rows) for name in columns}
    print(f"{'seed':8}" + "".join(f"{name.replace('_', ' '):>18}" for name in columns))
    for each in [*rows, {"seed": "median", **middle}]:
        print(f"{each['seed']!s:8}" + "".join(f"{each[name]:18.1f}" for name in columns))
    if args.json:
        told = {"machine": machine(), "cached": args.cached, "overrides": args.overrides, "median": middle}
        args.json.write_text(json.dumps(told | {"rows": rows}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
