"""Commands as their users run them, and a training that is over in seconds."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

VALLEY = [  # built in a tenth of the time of the default one, and flown in faster
    "env.world.size=[14,12]",
    "env.world.obstacles=3",
    "env.world.min_goal_distance=4",
]
DEFAULT_VALLEY = ["env.world.size=[40,30]", "env.world.obstacles=45", "env.world.min_goal_distance=10"]

TINY = [
    *VALLEY,
    "trainer.episodes=4",
    "env.num_uavs=2",
    "env.max_steps=20",
    "algo.learning_starts=40",
    "algo.hidden=[8]",
    "buffer.capacity=400",
    "trainer.checkpoint_interval=40",
    "trainer.progress=false",
    "trainer.execution=captured",
    "trainer.matmul=mkl",  # `auto` could turn with the process
]

SMALL_EVALUATION = ["episodes=2", "progress=false"]  # no more vehicles than tasks are flown


def in_process(main: Callable[[], None], *arguments: str) -> int:
    """Runs a command as the console script does, and returns its exit code."""
    before = sys.argv
    sys.argv = ["uavrl", *arguments]
    try:
        main()
    except SystemExit as exit_:
        return int(exit_.code or 0)
    finally:
        sys.argv = before
    return 0


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def newest(run_dir: Path) -> Path:
    return max((run_dir / "checkpoints").iterdir())
