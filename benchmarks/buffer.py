"""Memory and time of replay buffers: uavrl's, TorchRL's and Stable-Baselines3's.

Run `python benchmarks/buffer.py [--json FILE]`. States are 3 stacked frames of 35 numbers, actions 4 numbers, episodes
about 100 steps. Each row fills a buffer twice over in a process of its own, and memory is what that process holds more
than before. "uavrl, whole states" is the library's GatheringStorage, without its sharing of frames. Sampling draws 32
batches of 100 in one call (Stable-Baselines3: in 32 calls, as its `train` does, and also in one); writing is one
episode of 100 steps into the full buffer (Stable-Baselines3: step by step, its only way). Times are the least of many
repeats: the other programs of a machine only ever add to them.
"""

from __future__ import annotations

import argparse
import gc
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from common import machine
from tensordict import TensorDict

from uavrl_onboard.cli.process import one_sentence

FRAMES, WIDTH, ACTION, STEPS, BATCH, BATCHES = 3, 35, 4, 100, 100, 32
ROWS = ("uavrl", "uavrl, whole states", "TorchRL's LazyTensorStorage", "Stable-Baselines3")


def episode(steps: int) -> TensorDict:
    """One episode as the trainer stores it."""
    frames = torch.cat([torch.zeros(FRAMES - 1, WIDTH), torch.randn(steps + 1, WIDTH)])
    states = frames.unfold(0, FRAMES, 1).transpose(1, 2).flatten(1)
    last = torch.arange(steps)[:, None] == steps - 1
    flags = {name: last.clone() for name in ("done", "terminated", "arrived", "collided")}
    after = {"observation": states[1:], "reward": torch.randn(steps, 1), **flags}
    return TensorDict(
        {"observation": states[:-1], "action": torch.rand(steps, ACTION) * 4 - 2, "next": after}, [steps]
    ).clone()


def held() -> int:
    """Bytes of memory that this process holds."""
    status = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmRSS"))


def least(run: Callable[[], object], repeats: int) -> float:
    """The shortest time in milliseconds."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times) * 1e3


def torchrl_row(name: str, capacity: int) -> tuple[Callable[[TensorDict], object], dict[str, Callable[[], object]]]:
    """How to write an episode, and the ways to sample."""
    from torchrl.data import LazyTensorStorage, RandomSampler, TensorDictReplayBuffer

    from uavrl.buffers import FrameStorage, GatheringStorage

    storages = (FrameStorage(capacity, FRAMES), GatheringStorage(capacity), LazyTensorStorage(capacity))
    storage = storages[ROWS.index(name)]
    buffer = TensorDictReplayBuffer(storage=storage, sampler=RandomSampler())
    return buffer.extend, {"sample_ms": lambda: buffer.sample(BATCHES * BATCH).split(BATCH)}


def sb3_row(capacity: int) -> tuple[Callable[[TensorDict], object], dict[str, Callable[[], object]]]:
    """The same of Stable-Baselines3, whose buffer keeps both states of each transition."""
    from gymnasium.spaces import Box
    from stable_baselines3.common.buffers import ReplayBuffer

    states, actions = (Box(-np.inf, np.inf, (n,), np.float32) for n in (FRAMES * WIDTH, ACTION))
    buffer = ReplayBuffer(capacity, states, actions, device="cpu", optimize_memory_usage=False)

    def write(steps: TensorDict) -> None:
        keys = ("observation", ("next", "observation"), "action", ("next", "reward"), ("next", "done"))
        columns = [steps[key].numpy() for key in keys]
        for before, after, action, reward, done in zip(*columns, strict=True):
            buffer.add(before[None], after[None], action[None], reward, done, [{}])

    one_by_one: Callable[[], object] = lambda: [buffer.sample(BATCH) for _ in range(BATCHES)]  # noqa: E731
    return write, {"sample_ms": one_by_one, "sample_at_once_ms": lambda: buffer.sample(BATCHES * BATCH)}


def measure(name: str, transitions: int, repeats: int) -> dict[str, Any]:
    """The numbers of one row."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    flown = [episode(int(steps)) for steps in np.random.default_rng(0).integers(50, 151, 32)]
    gc.collect()
    write, samples = sb3_row(transitions) if name.startswith("Stable") else torchrl_row(name, transitions)
    for turn in range(2):  # the first one only to load what is loaded at the first use
        before = held()
        stored = 0
        while stored < (1000 if turn == 0 else 2 * transitions):
            steps = flown[(stored // STEPS) % len(flown)]
            write(steps.clone())
            stored += len(steps)
        taken = held() - before
    one = [episode(STEPS) for _ in range(repeats)]
    return {
        "bytes_per_transition": taken / (transitions - 1000),
        **{key: least(sample, repeats) for key, sample in samples.items()},
        "extend_ms": least(lambda: write(one.pop()), repeats),
    }


def main() -> None:
    """Measures, prints the table, and writes the JSON file if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--transitions", type=int, default=200_000, help="how many fill the buffer")
    parser.add_argument("--repeats", type=int, default=300, help="of sampling and of writing")
    parser.add_argument("--row", choices=ROWS, help="measure this row alone, in this process")
    args = parser.parse_args()
    if args.row:
        print(json.dumps(measure(args.row, args.transitions, args.repeats)))
        return
    about = machine()
    rows: dict[str, dict[str, float]] = {}
    for name in ROWS:
        arguments = ["--row", name, "--transitions", str(args.transitions), "--repeats", str(args.repeats)]
        output = subprocess.run([sys.executable, __file__, *arguments], check=True, capture_output=True, text=True)
        rows[name] = json.loads(output.stdout.splitlines()[-1])
    print(f"{args.transitions} transitions, one thread, least of {args.repeats} repeats\n")
    for name, row in rows.items():
        print(f"{name:30}" + ", ".join(f"{key} {value:.3f}" for key, value in row.items()))
    ours, _, torchrl, sb3 = (rows[name] for name in ROWS)
    ratios = {
        "memory_vs_torchrl": ours["bytes_per_transition"] / torchrl["bytes_per_transition"],
        "memory_vs_sb3": ours["bytes_per_transition"] / sb3["bytes_per_transition"],
        "sample_vs_torchrl": ours["sample_ms"] / torchrl["sample_ms"],
        "sample_vs_sb3": ours["sample_ms"] / sb3["sample_ms"],
    }
    print("\n" + ", ".join(f"{name} {value:.2f}" for name, value in ratios.items()))
    if args.json:
        numbers = {**ratios, "transitions": args.transitions, "threads": 1, "rows": rows, "machine": about}
        args.json.write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
