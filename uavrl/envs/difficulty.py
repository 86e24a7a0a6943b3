"""How hard a task is: how wide its shortest way is, and how much longer than a straight line."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse.csgraph import dijkstra

from uavrl.envs.place import Place
from uavrl.envs.tasks import CELL, Task
from uavrl.envs.world import World
from uavrl_onboard.guards.map.grid import Slices, grid_graph

WIDEST = 10.0  # m, largest width that is told apart


class Difficulty(NamedTuple):
    """Of one task.

    Attributes:
        spacing: Mean width of the free space along the shortest way in m, at most 10: twice the distance at the flight
            level to where a ball of ``uav_radius`` does not fit, and that ball.
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
        def weighed(here: Slices, there: Slices, apart: float) -> tuple[np.ndarray, np.ndarray]:
            both = place.fits[here] & place.fits[there]
            return both, np.full(both.shape, CELL * apart)

        self._graph = grid_graph(place.fits.shape, weighed)[0].tocsr()
        free = CELL * distance_transform_edt(np.pad(place.fits, 1, mode="edge"))[1:-1, 1:-1]
        self._width = (2 * (free + place.config.uav_radius)).clip(max=WIDEST)
        self._shape, self._first = place.fits.shape, place.origin + place.corner

    def measure(self, start: np.ndarray, goal: np.ndarray) -> Difficulty | None:
        """Measures one task.

        Args:
            start: ``[2]`` or more, in m, world frame.
            goal: As ``start``.

        Returns:
            None where no way at the flight level joins them.
        """
        cells = [self._cell(start), self._cell(goal)]
        (dx, dy) = np.abs(cells[0] - cells[1]) * CELL
        straight = float(max(dx, dy) + (2**0.5 - 1) * min(dx, dy))
        first, last = (int(np.ravel_multi_index(tuple(cell), self._shape)) for cell in cells)
        length, before = dijkstra(self._graph, directed=False, indices=first, return_predecessors=True)
        if not np.isfinite(length[last]) or straight == 0:
            return None
        way = [last]
        while way[-1] != first:
            way.append(int(before[way[-1]]))
        x, y = np.unravel_index(way, self._shape)
        return Difficulty(float(self._width[x, y].mean()), max(1.0, float(length[last]) / straight))

    def _cell(self, place: np.ndarray) -> np.ndarray:
        cell = np.rint((place[:2] - self._first) / CELL).astype(int)
        return np.clip(cell, 0, np.array(self._shape) - 1)


def measure_tasks(world: World, tasks: Sequence[Task]) -> list[Difficulty | None]:
    """Measures tasks of a world."""
    meters = {number: DifficultyMeter(world.places[number]) for number in sorted({task.place for task in tasks})}
    return [meters[task.place].measure(task.start, task.goal) for task in tasks]
