"""Runs of small, made up states that need no flight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.checkpoint import Checkpoint
from torchrl.data import TensorDictReplayBuffer

from uavrl.buffers import FrameStorage, MultiStep
from uavrl.runs.checkpoint import BufferState, rotation
from uavrl.runs.config import fingerprint, read_config

SMALL_PRETRAINING = [
    "progress=false",
    "pretrain=quick",
    "pretrain.states=400",
    "pretrain.features=4",
    "pretrain.hidden=16",
    "pretrain.psae_epochs=10",
    "pretrain.psae_lr=0.01",
    "pretrain.clusters=[2,3,4,5,6,8,10,12,14,16]",
    "pretrain.classifier_epochs=30",
    "pretrain.classifier_batch_size=32",
    "pretrain.one_shot=false",
]

OUTCOMES = ("arrived", "collided", "timed_out")


def walk(length: int, width: int, rng: np.random.Generator, places: int = 5) -> np.ndarray:
    """States of one episode that drift around one of some places, ``[length, width]``."""
    place = np.random.default_rng(rng.integers(places)).normal(size=width)
    return (place + np.cumsum(rng.normal(scale=0.02, size=(length, width)), 0)).astype(np.float32)


def drifting_run(run_dir: Path, episodes: int = 40, width: int = 6, seed: int = 0) -> list[np.ndarray]:
    """Makes a run and returns the states of its episodes."""
    rng = np.random.default_rng(seed)
    written = [walk(int(rng.integers(5, 20)), width, rng) for _ in range(episodes)]
    checkpoint_run(run_dir, written)
    return written


def transitions(states: np.ndarray, outcome: str) -> TensorDict:
    """One episode as the trainer stores it."""
    last = torch.arange(len(states))[:, None] == len(states) - 1
    observation = torch.from_numpy(states)
    following = {
        "observation": observation + 1,
        "reward": torch.zeros(len(states), 1),
        "done": last,
        "terminated": last & (outcome != "timed_out"),
        "arrived": last & (outcome == "arrived"),
        "collided": last & (outcome == "collided"),
    }
    return TensorDict(
        {"observation": observation, "action": torch.zeros(len(states), 4), "next": following}, [len(states)]
    )


def checkpoint_run(
    run_dir: Path,
    episodes: list[np.ndarray],
    capacity: int = 10_000,
    frames: int = 1,
    n_steps: int = 1,
    perception: str = "{angles: folded, lidar: {radius: 4}}",
) -> Path:
    """A run folder with a checkpoint whose replay buffer saw these episodes."""
    transform = MultiStep(n_steps, 0.9) if n_steps > 1 else None
    buffer = TensorDictReplayBuffer(storage=FrameStorage(capacity, frames), batch_size=4, transform=transform)
    for i, states in enumerate(episodes):
        buffer.extend(transitions(states, OUTCOMES[i % 3]))
    run_dir.mkdir(parents=True)
    config = f"algo: {{name: td3}}\nbuffer: {{capacity: {capacity}}}\nperception: {perception}\n"
    (run_dir / "config.yaml").write_text(config)
    checkpoint = Checkpoint(replay_data=BufferState(buffer), format="archive", archive_compression="stored")
    about = {
        "fingerprint": fingerprint(read_config(run_dir)),
        "seconds": 0.0,
        "collected_frames": len(buffer),
        "episodes": len(episodes),
    }
    return rotation(run_dir).save(checkpoint, step=1, metadata=about)
