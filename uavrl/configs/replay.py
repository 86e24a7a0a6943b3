"""Settings of ``uavrl-replay``. Meanings and units stand in the yaml."""

from dataclasses import dataclass

from uavrl.configs.checks import require
from uavrl.configs.evaluate import FlyingConfig
from uavrl.ranges import Count, Folder

MOST_FLIGHTS = 50  # in one page


@dataclass
class ReplayConfig(FlyingConfig):
    """conf/replay.yaml: the flights of one page."""

    flight: Folder | None = None
    task: int | None = None
    tasks: tuple[int, ...] | None = None
    episodes: Count | None = None
    data: Folder | None = None
    points: Count = 1500

    def __post_init__(self) -> None:
        """Checks what belongs together."""
        chosen = [key for key in ("task", "tasks", "episodes") if getattr(self, key) is not None]
        require(len(chosen) <= 1, "The choice of tasks", "one of task, tasks and episodes", " and ".join(chosen))
        told = [key for key in ("task", "tasks", "episodes", "valleys", "checkpoint") if getattr(self, key) is not None]
        own = "the only choice, since the file brings its flights"
        require(self.flight is None or not told, "flight", f"{own} (leave {', '.join(told)} out)", self.flight)
        require(self.task is None or self.task >= 0, "task", "a number from 0", self.task)
        listed = self.tasks
        distinct = listed is None or (len(listed) > 0 and min(listed) >= 0 and len(set(listed)) == len(listed))
        require(distinct, "tasks", "a list of different numbers from 0", listed)
        few = len(self.task_numbers) <= MOST_FLIGHTS
        require(few, "The number of flights", f"at most {MOST_FLIGHTS} in one page", len(self.task_numbers))

    @property
    def task_numbers(self) -> tuple[int, ...]:
        """The tasks to fly, in their order; task 0 if none is chosen."""
        if self.tasks is not None:
            return tuple(self.tasks)
        return tuple(range(self.episodes)) if self.episodes is not None else (self.task or 0,)
