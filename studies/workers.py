"""How training gets faster with processes that fly beside the learner: measured here, and a model of more of them.

    PYTHONPATH=benchmarks python studies/workers.py [--json FILE]

On a quiet machine; it needs Ray (`uavrl[ray]`) and about 15 minutes.
Each row is `uavrl-train` in the static valley, 8 UAVs a process, for `--steps` steps after `--warm-up` of them, in
which updates are compiled and the random steps flown; the clock is the one that runs log.

The model has two numbers, what a step of flying costs and what an update costs, taken from the two rows with
`collector=sync`, which does both in turn: 1 / rate = flying + updates_per_step · update. W workers with cores of their
own then fly W / flying steps a second, and the learner learns from 1 / (updates_per_step · update) of them: the smaller
of the two is the rate. On `cores` cores it is at most cores times the rate of `collector=sync`.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import experiment, machine

from uavrl_onboard.cli.process import one_sentence

UPDATES = (1.0, 0.25)  # a step
MODELLED = (1, 2, 4, 8, 16)  # workers with a core each
FLIGHT = 110  # steps, about, of a flight that arrives


class Row(NamedTuple):
    """What flies."""

    name: str
    overrides: tuple[str, ...]


ROWS = (
    Row("sync", ("collector=sync",)),
    Row("async", ("collector=async",)),
    Row("ray, 1 worker", ("collector=ray", "collector.workers=1")),
    Row("ray, 2 workers", ("collector=ray", "collector.workers=2")),
)


def rate(row: Row, updates: float, warm_up: int, steps: int) -> float:
    """Steps a second that a run learns from, random steps and the first updates left out."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        command = [sys.executable, "-m", "uavrl.cli.train", f"run_dir={run}", *row.overrides, "trainer.progress=false"]
        command += [
            f"trainer.updates_per_step={updates}",
            "algo.learning_starts=1000",
            "logger=csv",
            "logger.interval=500",
        ]
        environment = os.environ | {f"{key}_NUM_THREADS": "1" for key in ("OMP", "MKL", "OPENBLAS")}
        training = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            while training.poll() is None:
                time.sleep(1)
                at, minutes = logged(run)
                if len(at) and at[-1] >= warm_up + steps:
                    kept = at >= warm_up
                    return float((at[kept][-1] - at[kept][0]) / (minutes[kept][-1] - minutes[kept][0]) / 60)
        finally:
            training.send_signal(signal.SIGTERM)
            _, errors = training.communicate()
    raise SystemExit(f"{row.name} ended before it was measured: {errors}")


def logged(run: Path) -> tuple[np.ndarray, np.ndarray]:
    """Steps and the minutes after which they were learned from."""
    files = list((run / "logs").rglob("minutes.csv"))
    lines = [line.split(",") for line in files[0].read_text(encoding="utf-8").splitlines()[:-1]] if files else []
    return np.array([float(line[0]) for line in lines]), np.array([float(line[1]) for line in lines])


def wire() -> dict[str, float]:
    """Bytes that a step, and the weights, take on their way between a worker and the learner."""
    import torch
    from tensordict import TensorDict

    from uavrl.evaluation.environment import make_env
    from uavrl.losses.networks import make_actor, network_sizes
    from uavrl.training.build import make_collector

    settings = experiment("env.num_uavs=1", "collector=sync")
    env = make_env(settings.env, settings.perception, settings.reward, seed=0)
    sizes = network_sizes(env)
    actor = make_actor(settings, sizes, torch.device("cpu"))
    collector = make_collector(settings, env, actor, sizes, torch.device("cpu"))
    flight = next(iter(collector))
    collector.shutdown()
    return {"step": flight.bytes() / len(flight), "weights": float(TensorDict.from_module(actor).bytes())}


def modelled(rates: dict[str, dict[float, float]]) -> dict[str, Any]:
    """Seconds of flying and of an update, and the rates that follow for workers with cores of their own."""
    one, few = (1 / rates["sync"][updates] for updates in UPDATES)
    update = (one - few) / (UPDATES[0] - UPDATES[1])
    flying = one - UPDATES[0] * update
    return {
        "flying": flying,
        "update": update,
        "rates": {
            str(updates): {str(workers): min(workers / flying, 1 / (updates * update)) for workers in MODELLED}
            for updates in UPDATES
        },
    }


def main() -> None:
    """Times the rows, prints table and model, and writes the file that was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=12_000, help="steps that are timed")
    parser.add_argument("--warm-up", type=int, default=6_000, help="steps before them")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    args = parser.parse_args()
    about = machine()
    rates: dict[str, dict[float, float]] = {row.name: {} for row in ROWS}
    for updates in UPDATES:
        for row in ROWS:
            rates[row.name][updates] = rate(row, updates, args.warm_up, args.steps)
    model, bytes_sent = modelled(rates), wire()
    print("steps a second at", *(f"{updates:g} updates a step" for updates in UPDATES), sep="\t")
    for name, found in rates.items():
        print(f"{name:26}", *(f"{found[updates]:.1f}" for updates in UPDATES), sep="\t")
    print(f"\nmodel: a step of flying {1e3 * model['flying']:.2f} ms, an update {1e3 * model['update']:.2f} ms")
    for workers in MODELLED:
        each = [model["rates"][str(updates)][str(workers)] for updates in UPDATES]
        print(f"{workers:2} workers with cores", *(f"{value:.0f}" for value in each), sep="\t")
    sent = bytes_sent["step"] + bytes_sent["weights"] / FLIGHT
    print(
        f"\n{bytes_sent['step']:.0f} bytes a step, {bytes_sent['weights']:.0f} of weights a flight: {sent:.0f} a step"
    )
    if args.json:
        result = {"rates": rates, "model": model, "bytes": bytes_sent, "machine": about}
        args.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
