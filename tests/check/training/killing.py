"""Kills trainings at random moments, and compares them with one that was left alone.

python -m tests.check.training.killing FOLDER --kills 50

Trains each of two configurations once without a stop, and then again and again in processes that are ended by
kill -9, SIGTERM or Ctrl-C and resumed, until there were as many kills as asked for. Each run must end bit-identical to
the first.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import random
import signal
import time
from collections import Counter
from multiprocessing.context import ForkProcess
from pathlib import Path

from tests.helpers.commands import in_process
from tests.helpers.runs import ABR, FORK_AND_LIFEGUARD, SMALL, assert_same_run
from uavrl.cli import train as train_command

LENGTH = ["logger.interval=1", "trainer.episodes=24"]
CONFIGURATIONS = {
    "fork_lifeguard": [*SMALL, *FORK_AND_LIFEGUARD, *LENGTH],
    "prioritized_abr_dynamic": [*SMALL, *ABR, "env=dynamic", "buffer=prioritized", *LENGTH],
}
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


def train(said: Path, *arguments: str) -> None:
    """A training from the command line, in a forked process: imports are long and write nothing."""
    with said.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        code = in_process(train_command.main, *arguments)
    except KeyboardInterrupt:  # before the training began
        code = 130
    raise SystemExit(code)  # ends as a process does: whatever is left behind is told


def started(run_dir: Path, overrides: list[str]) -> ForkProcess:
    """A training that begins, or goes on where there is something to go on with."""
    begun = (run_dir / "config.yaml").exists()
    arguments = [f"resume={run_dir}"] if begun else [*overrides, f"run_dir={run_dir}"]
    run_dir.parent.mkdir(parents=True, exist_ok=True)
    process = multiprocessing.get_context("fork").Process(target=train, args=(run_dir.parent / "said.txt", *arguments))
    process.start()
    return process


def left_alone(run_dir: Path, overrides: list[str]) -> float:
    """Trains without a stop; returns the seconds that it took."""
    begun = time.monotonic()
    process = started(run_dir, overrides)
    process.join()
    assert process.exitcode == 0, (run_dir.parent / "said.txt").read_text()
    return time.monotonic() - begun


def killed(run_dir: Path, overrides: list[str], seconds: float, rng: random.Random, most: int) -> Counter[str]:
    """Trains to the end over at most so many kills; returns how often which signal ended a process."""
    kills: Counter[str] = Counter()
    while True:
        number, pause = rng.choice(SIGNALS), rng.uniform(0, seconds)
        process = started(run_dir, overrides)
        process.join(pause if kills.total() < most else None)
        if process.exitcode is None:
            os.kill(process.pid, number)
            process.join()
        said = (run_dir.parent / "said.txt").read_text()
        assert "Traceback" not in said and "leaked" not in said, said
        if process.exitcode == 0:
            return kills
        assert process.exitcode in (-number, 128 + number), said
        kills[number.name] += 1


def main(arguments: list[str] | None = None) -> str:
    """Says how often what was killed, where all is bit-identical."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--most", type=int, default=8, help="kills of one run")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    rng = random.Random(args.seed)
    seconds: dict[str, float] = {}
    total: Counter[str] = Counter()
    for run, (name, overrides) in enumerate(itertools.cycle(CONFIGURATIONS.items()), 1):
        alone, run_dir = args.folder / name / "run", args.folder / f"{name}_{run}" / "run"
        if name not in seconds:
            seconds[name] = left_alone(alone, overrides)
        total += killed(run_dir, overrides, seconds[name], rng, min(args.most, args.kills - total.total()))
        assert_same_run(alone, run_dir)
        how = ", ".join(f"{total[number.name]} {number.name}" for number in SIGNALS)
        result = f"{total.total()} kills ({how}) of {run} runs in {len(seconds)} configurations: all bit-identical"
        print(result, flush=True)
        if total.total() == args.kills:
            return result
    raise AssertionError


if __name__ == "__main__":
    main()
