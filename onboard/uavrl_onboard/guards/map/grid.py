"""The graph of a grid's cells, through which ways are searched."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Slices = tuple[slice, slice]
Weigh = Callable[[Slices, Slices, float], tuple[np.ndarray, np.ndarray]]


NEIGHBOURS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [-1, -1], [-1, 0], [-1, 1], [0, -1]])
"""Rows and columns from a cell to each of those around it."""
OPPOSITE = (5, 7, 4, 6)  # of the first four


def grid_graph(shape: tuple[int, ...], weigh: Weigh) -> tuple[csr_array, np.ndarray]:
    """Join each cell of a flat grid to those of its eight neighbours that can be reached.

    Args:
        shape: rows and columns of the grid.
        weigh: takes slices that lay each cell over its neighbour, and how far apart these are in cells; it returns
            which of the pairs are joined, and the length of each.

    Returns:
        The graph, each edge in both directions, and the number of each cell in it, ``int [rows, columns]``.

    Examples:
        >>> free = np.array([[True, True], [False, True]])
        >>> graph, index = grid_graph(free.shape, lambda a, b, far: (free[a] & free[b], np.full(free[a].shape, far)))
        >>> graph.toarray()[index[0, 0]].round(2).tolist()
        [0.0, 1.0, 0.0, 1.41]
    """
    from scipy.sparse import csr_array  # here, since SciPy loads in half a second and only a map needs it

    joined, lengths = np.zeros((*shape, len(NEIGHBOURS)), bool), np.empty((*shape, len(NEIGHBOURS)))
    for one, (other, (i, j)) in enumerate(zip(OPPOSITE, NEIGHBOURS.tolist(), strict=False)):
        here = (slice(None, -i or None), slice(max(-j, 0), -j if j > 0 else None))
        there = (slice(i, None), slice(max(j, 0), j if j < 0 else None))
        which, length = weigh(here, there, float(np.hypot(i, j)))
        joined[(*here, one)] = joined[(*there, other)] = which
        lengths[(*here, one)] = lengths[(*there, other)] = length
    edges = np.flatnonzero(joined)
    cells, towards = np.divmod(edges.astype(np.int32), np.int32(len(NEIGHBOURS)))
    offsets = (NEIGHBOURS @ [shape[1], 1]).astype(np.int32)
    count = int(np.prod(shape))
    ends = np.zeros(count + 1, np.int32)
    np.cumsum(np.bincount(cells, minlength=count), out=ends[1:])
    graph = csr_array((lengths.reshape(-1).take(edges), cells + offsets.take(towards), ends), (count, count))
    return graph, np.arange(count).reshape(shape)
