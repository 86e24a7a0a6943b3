"""The reductions of a scan in numpy, for machines without PyTorch: those of :mod:`uavrl.transforms`, to 1e-6.

Their definitions stand there; where the cells lie, and what a return is, both take from
:mod:`uavrl_onboard.perception.cells`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import NEAREST_RETURN, Columns
from uavrl_onboard.perception.cells import (
    LARGEST_RADIUS,
    NUM_FACES,
    TOUCHING,
    VLP16_GRID,
    RangeGrid,
    Statistic,
    icosahedron,
    octant,
    range_image_middles,
    return_bounds,
)
from uavrl_onboard.perception.view import View, in_view

Reduction = Literal["truncated_icosahedron", "range_image"]


def truncated_icosahedron(
    points: np.ndarray, radius: float = 4.0, statistic: Statistic = "face", *, view: View | None = None
) -> np.ndarray:
    """Reduces one cloud to 32 distances, as `uavrl.transforms.icosahedron.truncated_icosahedron` does.

    Args:
        points: ``[P, 3]`` in metres in the sensor frame, float32 or float64; NaN, infinity and zeros are misses.
        radius: circumradius in metres.
        statistic: what a face reports: ``"face"``, ``"range"`` or ``"proximity"``.
        view: the field of view outside of which points do not count; None: all count.

    Returns:
        ``[32]`` in metres.

    Raises:
        UavrlError: for points of another shape or type, and for another radius or statistic.

    Examples:
        >>> seen = truncated_icosahedron(np.array([[0.0, 0.0, 3.0], [np.nan] * 3]))
        >>> seen.shape, np.flatnonzero(seen).tolist()
        ((32,), [30])
    """
    x, y, z = _returns(points, radius, statistic, view)
    normals, centres, offsets, images = _faces(float(radius), x.dtype)
    mirrored = (x < 0.0) * 4 + (y < 0.0) * 2 + (z < 0.0)  # see `uavrl_onboard.perception.cells.octant`
    x, y, z = np.abs(x), np.abs(y), np.abs(z)
    heights = normals[0, :, None] * x + normals[1, :, None] * y + normals[2, :, None] * z  # [7, M]
    pentagons, hexagons = heights[:3].argmax(0), heights[3:].argmax(0)
    to_pentagon, to_hexagon = heights[:3].max(0), heights[3:].max(0)
    inside = (to_pentagon <= offsets[0]) & (to_hexagon <= offsets[1])
    # ‖p - c_i‖² - ‖p‖² of the nearest centre of each kind
    nearer = offsets[0] * (offsets[0] - 2.0 * to_pentagon) < offsets[1] * (offsets[1] - 2.0 * to_hexagon)
    face = np.where(nearer, pentagons, hexagons + 3)
    if statistic == "face":
        x, y, z = (at - centre[face] for at, centre in zip((x, y, z), centres, strict=True))
    return _reported(x, y, z, images[mirrored * 7 + face], NUM_FACES, radius, statistic, inside)


def range_image(
    points: np.ndarray,
    radius: float = 4.0,
    statistic: Statistic = "proximity",
    grid: RangeGrid = VLP16_GRID,
    *,
    view: View | None = None,
) -> np.ndarray:
    """Reduces one cloud to 72 distances, as `uavrl.transforms.range_image.range_image` does.

    Args:
        points: as in `truncated_icosahedron`.
        radius: of the ball in metres.
        statistic: as there.
        grid: where the cells are.
        view: as in `truncated_icosahedron`.

    Returns:
        ``[72]``, or ``[grid.count]``, in metres.

    Raises:
        UavrlError: as there.

    Examples:
        >>> seen = range_image(np.array([[3.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
        >>> seen.shape, np.flatnonzero(seen).tolist(), float(seen[1])
        ((72,), [1], 1.0)
    """
    x, y, z = _returns(points, radius, statistic, view)
    across = np.sqrt(x * x + y * y)
    column = np.round(np.arctan2(y, x) * (grid.columns / (2.0 * np.pi))).astype(np.int64) % grid.columns
    elevation = np.arctan2(z, across)
    cell = sum(((elevation > math.radians(each)).astype(np.int64) for each in grid.row_borders), column * grid.rows)
    if statistic == "face":
        middles = (radius * range_image_middles(grid).astype(x.dtype)).astype(x.dtype)
        x, y, z = (at - middle[cell] for at, middle in zip((x, y, z), middles.T, strict=True))
    return _reported(x, y, z, cell, grid.count, radius, statistic)


REDUCTIONS: dict[Reduction, Callable[..., np.ndarray]] = {
    "truncated_icosahedron": truncated_icosahedron,
    "range_image": range_image,
}
STATISTICS: dict[Reduction, Statistic] = {"truncated_icosahedron": "face", "range_image": "proximity"}
"""What each reports unless it is told otherwise."""


def directions(reduction: Reduction, grid: RangeGrid = VLP16_GRID) -> np.ndarray:
    """Unit vectors through the cells of a reduction; ``grid`` is that of a range image."""
    return icosahedron(1.0).normals if reduction == "truncated_icosahedron" else range_image_middles(grid)


def _returns(
    points: np.ndarray, radius: float, statistic: str, view: View | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The coordinates ``[M]`` of all returns from within the ball and the field of view."""
    if not isinstance(points, np.ndarray) or points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        came = f"{points.dtype} {list(points.shape)}" if isinstance(points, np.ndarray) else type(points).__name__
        raise UavrlError(f"points must be an array of floats [P, 3], got {came}: pass one scan in metres.")
    if not NEAREST_RETURN < radius <= LARGEST_RADIUS:
        raise UavrlError(f"radius must be in ({NEAREST_RETURN:g}, {LARGEST_RADIUS:g}] metres, got {radius!r}.")
    if statistic not in get_args(Statistic):
        raise UavrlError(f"statistic must be one of {', '.join(get_args(Statistic))}, got {statistic!r}.")
    columns = Columns.of(points)
    x, y, z = columns.points.take(columns.between(return_bounds(radius)), axis=1)
    if view is not None and not (seen := in_view(x, y, z, view)).all():
        x, y, z = x[seen], y[seen], z[seen]
    return x, y, z


def _reported(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    cell: np.ndarray,
    cells: int,
    radius: float,
    statistic: str,
    inside: np.ndarray | None = None,
) -> np.ndarray:
    """The least length of (x, y, z) in each cell, or what ``"proximity"`` makes of it; 0 where there is none."""
    lengths = np.clip(np.sqrt(x * x + y * y + z * z), TOUCHING * radius, radius)
    if inside is not None:
        lengths, cell = lengths[inside], cell[inside]
    least = np.full(cells, np.inf, lengths.dtype)
    np.minimum.at(least, cell, lengths)
    if statistic == "proximity":
        return np.maximum(radius - least, 0.0).astype(least.dtype)
    return np.where(np.isinf(least), 0.0, least).astype(least.dtype)


@lru_cache(maxsize=64)
def _faces(radius: float, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray, tuple[float, float], np.ndarray]:
    """Normals and centres ``[3, 7]`` of one octant's faces, both kinds' distances, and the images' ids ``[56]``."""
    faces, (first, images) = icosahedron(radius), octant()
    centres = (faces.offsets[:, None] * faces.normals)[first]
    kinds = float(faces.offsets[0]), float(faces.offsets[-1])
    return faces.normals[first].T.astype(dtype), centres.T.astype(dtype), kinds, images
