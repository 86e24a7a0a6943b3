"""The graph of a grid's cells, through which ways are searched."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import coo_array

Slices = tuple[slice, slice]
Weigh = Callable[[Slices, Slices, float], tuple[np.ndarray, np.ndarray]]


def grid_graph(shape: tuple[int, ...], weigh: Weigh) -> tuple[coo_array, np.ndarray]:
    """Join each cell of a flat grid to those of its eight neighbours that can be reached.

    Args:
        shape: rows and columns of the grid.
        weigh: takes slices that lay each cell over its neighbour, and how far apart these are in cells; it returns
            which of the pairs are joined, and the length of each.

    Returns:
        The graph, each edge once, and the number of each cell in it, ``int [rows, columns]``.

    Examples:
        >>> free = np.array([[True, True], [False, True]])
        >>> graph, index = grid_graph(free.shape, lambda a, b, far: (free[a] & free[b], np.full(free[a].shape, far)))
        >>> graph.toarray()[index[0, 0]].round(2).tolist()
        [0.0, 1.0, 0.0, 1.41]
    """
    from scipy.sparse import coo_array  # here, since SciPy loads in half a second and only a map needs it

    index = np.arange(np.prod(shape)).reshape(shape)
    first, second, lengths = [], [], []
    for i, j in ((1, 0), (0, 1), (1, 1), (1, -1)):
        here = (slice(None, -i or None), slice(max(-j, 0), -j if j > 0 else None))
        there = (slice(i, None), slice(max(j, 0), j if j < 0 else None))
        joined, length = weigh(here, there, float(np.hypot(i, j)))
        first.append(index[here][joined])
        second.append(index[there][joined])
        lengths.append(length[joined])
    edges = np.concatenate(first), np.concatenate(second)
    return coo_array((np.concatenate(lengths), edges), (index.size, index.size)), index
