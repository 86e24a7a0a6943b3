"""Typed configuration of ``uavrl-replay``. Meanings and units stand in the yaml."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from uavrl.configs.checks import require, require_products
from uavrl.configs.valley import EnvConfig, PerceptionConfig

MOST_FLIGHTS = 50  # in one page


@dataclass
class ReplayConfig:
    """conf/replay.yaml: the flights of one page."""

    run: str | None = None
    policy: str | None = None
    flight: str | None = None
    env: EnvConfig = field(default_factory=EnvConfig)
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    reward: Any = None
    task: int | None = None
    tasks: tuple[int, ...] | None = None
    episodes: int | None = None
    seed: int = 20_000
    valleys: tuple[int, ...] | None = None
    checkpoint: str | None = None
    output: str | None = None
    video: str | None = None
    data: str | None = None
    points: int = 1500
    device: str = "cpu"
    threads: int = 1
    products: str = "mkl"
    progress: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        chosen = [key for key in ("task", "tasks", "episodes") if getattr(self, key) is not None]
        require(len(chosen) <= 1, "The choice of tasks", "one of task, tasks and episodes", " and ".join(chosen))
        told = [key for key in ("task", "tasks", "episodes", "valleys", "checkpoint") if getattr(self, key) is not None]
        own = "the only choice, since the file brings its flights"
        require(self.flight is None or not told, "flight", f"{own} (leave {', '.join(told)} out)", self.flight)
        require(self.task is None or self.task >= 0, "task", "a number from 0", self.task)
        require(self.episodes is None or self.episodes >= 1, "episodes", "at least 1", self.episodes)
        listed = self.tasks
        distinct = listed is None or (len(listed) > 0 and min(listed) >= 0 and len(set(listed)) == len(listed))
        require(distinct, "tasks", "a list of different numbers from 0", listed)
        few = len(self.task_numbers) <= MOST_FLIGHTS
        require(few, "The number of flights", f"at most {MOST_FLIGHTS} in one page", len(self.task_numbers))
        for key in ("points", "threads"):
            require(getattr(self, key) >= 1, key, "at least 1", getattr(self, key))
        seeds = self.valleys
        require(
            seeds is None or (len(seeds) > 0 and min(seeds) >= 0), "valleys", "null or a list of seeds from 0", seeds
        )
        require(0 <= self.seed < 2**31, "seed", "in [0, 2**31)", self.seed)
        require_products(self.products)

    @property
    def task_numbers(self) -> tuple[int, ...]:
        """The tasks to fly, in their order; task 0 if none is chosen."""
        if self.tasks is not None:
            return tuple(self.tasks)
        return tuple(range(self.episodes)) if self.episodes is not None else (self.task or 0,)
