"""The free cells of a place at its flight level, and the shortest ways through them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse.csgraph import dijkstra

from uavrl.envs.place import Place
from uavrl.envs.tasks import CELL
from uavrl_onboard.guards.map.grid import Slices, grid_graph


class Ways(NamedTuple):
    """The shortest ways from all cells to one, of cells in the order of ``ravel``.

    Attributes:
        lengths: The cost of each path, which is its length in m unless cells cost more; infinite if there is no path.
        ahead: The next cell on the path from each cell; negative at the last cell and if there is no path.
    """

    lengths: np.ndarray
    ahead: np.ndarray


class LevelMap:
    """Where a ball of ``uav_radius`` fits in one place at its flight level, on the grid of its map.

    Args:
        place: The place to map.
        comfort: Distance in m from where the ball does not fit within which a cell costs more.
        crowded: Additional cost of a cell next to that, as a multiple of its length.

    Attributes:
        width: Width of the free space at each cell, ``[X, Y]`` in m: twice the distance from the cell to where the ball
            does not fit, and the ball.
        shape: X and Y.
    """

    def __init__(self, place: Place, *, comfort: float = 1.0, crowded: float = 0.0) -> None:
        fits = place.fits
        free = CELL * distance_transform_edt(np.pad(fits, 1, mode="edge"))[1:-1, 1:-1]
        cost = 1 + crowded * (1 - free / comfort).clip(0, 1)

        def weighed(here: Slices, there: Slices, apart: float) -> tuple[np.ndarray, np.ndarray]:
            return fits[here] & fits[there], CELL * apart * (cost[here] + cost[there]) / 2

        self.shape = fits.shape
        self.width = 2 * (free + place.config.uav_radius)
        self.first = place.origin + place.corner
        self._graph = grid_graph(fits.shape, weighed)[0]
        self._fitting = np.stack(distance_transform_edt(~fits, return_distances=False, return_indices=True), -1)

    def cell(self, positions: np.ndarray) -> np.ndarray:
        """The cells ``[..., 2]`` of positions ``[..., 2]`` or more numbers, in m, world frame."""
        cells = np.rint((positions[..., :2] - self.first) / CELL).astype(int)
        return np.clip(cells, 0, np.array(self.shape) - 1)

    def fitting_cell(self, positions: np.ndarray) -> np.ndarray:
        """The cells nearest to those of positions in which the ball fits."""
        return self._fitting[tuple(np.moveaxis(self.cell(positions), -1, 0))]

    def number(self, cells: np.ndarray) -> np.ndarray:
        """The numbers of cells ``[..., 2]`` in the order of ``ravel``."""
        return np.ravel_multi_index(tuple(np.moveaxis(cells, -1, 0)), self.shape)

    def middle(self, numbers: np.ndarray) -> np.ndarray:
        """The middles ``[..., 2]`` of cells, in m, world frame."""
        return self.first + CELL * np.stack(np.unravel_index(numbers, self.shape), -1)

    def ways_to(self, cell: np.ndarray) -> Ways:
        """The shortest ways from all cells to one ``[2]``, in eight directions.

        Source: Dijkstra (1959), A note on two problems in connexion with graphs.
        """
        last = int(self.number(cell))
        return Ways(*dijkstra(self._graph, indices=last, return_predecessors=True))
