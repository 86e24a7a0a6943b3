"""How hard a task is: how wide its shortest way is, and how much longer than a straight line."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uavrl.envs.level_map import LevelMap
from uavrl.envs.place import Place
from uavrl.envs.tasks import CELL, Task
from uavrl.envs.world import World

WIDEST = 10.0  # m, largest width that is told apart
NARROW = 1e-6  # more that a narrow cell costs, as a share of its length: it decides among equally short ways only


class Difficulty(NamedTuple):
    """Of one task.

    Attributes:
        spacing: Mean width of the free space along the shortest way in m, at most 10: twice the distance at the flight
            level to where a ball of ``uav_radius`` does not fit, and that ball. Of equally short ways it is the widest.
        detour: Length of the shortest way over that of the way without any obstacle; 1 or more.
    """

    spacing: float
    detour: float


class DifficultyMeter:
    """Measures tasks of one place, at its flight level.

    Source: Yu et al. (2024), "FlightBench" (arXiv 2406.05687), measures the difficulty of tasks by free spheres along
    a guiding path, among others. Here the path is the shortest of a ball of ``uav_radius`` on the place's map, in eight
    directions, and the radii of the spheres are averaged; our numbers and theirs cannot be compared.

    Args:
        place: Where the tasks are.
    """

    def __init__(self, place: Place) -> None:
        self._map = LevelMap(place, comfort=WIDEST / 2 - place.config.uav_radius, crowded=NARROW)

    def measure(self, start: np.ndarray, goal: np.ndarray) -> Difficulty | None:
        """Measures one task.

        Args:
            start: ``[2]`` or more, in m, world frame.
            goal: As ``start``.

        Returns:
            None where no way at the flight level joins them.
        """
        cells = self._map.cell(start), self._map.cell(goal)
        (dx, dy) = np.abs(cells[0] - cells[1]) * CELL
        straight = float(max(dx, dy) + (2**0.5 - 1) * min(dx, dy))
        ways = self._map.ways_to(cells[1])
        if not np.isfinite(ways.lengths[self._map.number(cells[0])]) or straight == 0:
            return None
        way = [int(self._map.number(cells[0]))]
        while ways.ahead[way[-1]] >= 0:
            way.append(int(ways.ahead[way[-1]]))
        widths = self._map.width.ravel()[way].clip(max=WIDEST)
        steps = CELL * np.linalg.norm(np.diff(np.unravel_index(way, self._map.shape)), axis=0)
        spacing = float(steps @ (widths[1:] + widths[:-1]) / 2 / steps.sum())
        return Difficulty(spacing, max(1.0, float(steps.sum()) / straight))


def measure_tasks(world: World, tasks: Sequence[Task]) -> list[Difficulty | None]:
    """Measures tasks of a world."""
    meters = {number: DifficultyMeter(world.places[number]) for number in sorted({task.place for task in tasks})}
    return [meters[task.place].measure(task.start, task.goal) for task in tasks]
