"""Small training runs, and when two of them are the same."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig

from tests.helpers.commands import DEFAULT_VALLEY, VALLEY
from tests.helpers.configs import with_run_dir
from uavrl.runs.checkpoint import rotation

SMALL = [
    *VALLEY,
    "env.num_uavs=2",
    "env.max_steps=12",
    "algo.learning_starts=40",
    "algo.hidden=[16,16]",
    "algo.batch_size=8",
    "buffer.capacity=400",
    "trainer.checkpoint_interval=20",
    "trainer.keep_checkpoints=10",
    "trainer.progress=false",
    "trainer.matmul=mkl",  # `auto` could turn with the machine's load
    "trainer.execution=captured",  # compiling takes longer than these runs
]

LIFEGUARD = [  # heard after a few collisions, which a wide hull among many obstacles brings about
    *DEFAULT_VALLEY,
    "env.airframe.collision_radius=1.45",
    "env.world.obstacles=90",
    "env.max_steps=30",
    "lifeguard.min_collisions=3",
    "lifeguard.min_evaluations=1",
    "lifeguard.min_true_negative_rate=0",
    "lifeguard.batch_size=8",
]

FORK_AND_LIFEGUARD = [
    "fork=on",
    "fork.threshold=10",
    "fork.system_network.hidden=[16]",
    "fork.reward_network.hidden=[16]",
    "lifeguard=mlp",
    *LIFEGUARD,
]

SAC = ["algo=sac", "lifeguard=linear", *LIFEGUARD]

ABR = [  # some goals are so near that random flights arrive; one class for nearly all states
    *DEFAULT_VALLEY,
    "backward_reward=abr",
    "backward_reward.threshold=0.1",
    "env.world.goal_radius=12",
    "env.max_steps=40",
    "trainer.episodes=20",  # none of the first 16 arrives
]


def small_config(run_dir: Path, *overrides: str, base: Sequence[str] = SMALL) -> DictConfig:
    return with_run_dir(run_dir, *base, *overrides)


def contents(checkpoint: Path) -> dict[str, bytes]:
    """Everything in a checkpoint that bears on learning.

    Left out: the manifest (times), the logger (paths), the collector (its count of trajectory ids goes on where a
    resumed process numbers its first ones; its policy is compared as such) and the order of keys in the data's index.
    """
    left_out = ("manifest.json", "-logger/", "-collector/", "transitions/meta.json", "transitions/next/meta.json")
    with zipfile.ZipFile(checkpoint) as archive:
        names = [n for n in archive.namelist() if not any(part in n for part in left_out)]
        return {name: archive.read(name) for name in names}


def logged(run_dir: Path) -> dict[str, bytes]:
    """What the CSV logger wrote, but for times."""
    files = (run_dir / "logs").rglob("*.csv")
    times = ("backward_seconds.csv", "minutes.csv")
    return {file.name: file.read_bytes() for file in files if file.name not in times}


def assert_same_run(one: Path, other: Path) -> None:
    assert (one / "episodes.csv").read_bytes() == (other / "episodes.csv").read_bytes()
    assert logged(one) == logged(other)
    last = [contents(rotation(run).latest()) for run in (one, other)]
    assert last[0].keys() == last[1].keys()
    differing = [name for name in last[0] if last[0][name] != last[1][name]]
    assert not differing
    assert len(last[0]) > 30
