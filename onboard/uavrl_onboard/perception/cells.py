"""Where the cells of the two LiDAR reductions lie, and which points count: numpy alone."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from uavrl_onboard.geometry import NEAREST_RETURN

Statistic = Literal["face", "range", "proximity"]

NUM_FACES = 32
"""Faces of the truncated icosahedron, 12 pentagons and then 20 hexagons."""
AZIMUTHS, ELEVATIONS = 24, 3  # cells of the range image
ROWS = math.radians(10.0)  # from one row's middles to the next: three span the ±15 degrees of a VLP-16
ROW_BORDERS = (math.radians(-4.0), math.radians(4.0))  # elevations half-way between lasers: at ±5 rounding would choose

LARGEST_RADIUS = 1e6  # m: the squares of much larger ones overflow
TOUCHING = 1e-6  # of the radius: what a cell reads that a point touches, as 0 means "no point"
LASERS = 16
"""Of a VLP-16, fired in turn: a scan is 1808 such firing cycles."""
AZIMUTH_STEP = 2.0 * math.pi * 10.0 * 55.296e-6  # rad from one firing cycle to the next at 10 Hz: 0.1991°
FAR_EVERY = 5  # of the firing cycles, which look farther than the cells: one to a degree
# The ball stops this much (relative, squared) short of its radius, so that float32 rounding cannot let in a point that
# a sensor whose range ends at the radius does not report; and it begins this much after the housing.
_ROUNDING = 2e-6

_PHI = (1.0 + math.sqrt(5.0)) / 2.0


class Faces(NamedTuple):
    """The faces of a truncated icosahedron around the origin, ``float64``."""

    normals: np.ndarray  #: ``[32, 3]``, outward unit normals
    offsets: np.ndarray  #: ``[32]``, distances from the origin to the face planes in m


def return_bounds(radius: float) -> tuple[float, float]:
    """Between which squared distances a point is a return from within the ball of ``radius`` metres, both excluded."""
    return NEAREST_RETURN**2 * (1.0 + _ROUNDING), radius**2 * (1.0 - _ROUNDING)


def _cyclic(triples: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """Returns all cyclic permutations and sign changes of ``triples``, sorted by z, then azimuth in [0, 2π)."""
    points = set()
    for a, b, c in triples:
        for x, y, z in ((a, b, c), (c, a, b), (b, c, a)):
            points |= {(i * x + 0.0, j * y + 0.0, k * z + 0.0) for i in (1, -1) for j in (1, -1) for k in (1, -1)}
    return sorted(points, key=lambda p: (round(p[2], 9), round(math.atan2(p[1], p[0]) % math.tau, 9)))


def icosahedron(radius: float) -> Faces:
    """The truncated icosahedron whose 60 vertices lie ``radius`` metres from the origin.

    Pentagons come first (0-11), then hexagons (12-31), each group sorted by the z of its centre, lowest first, then by
    azimuth ``atan2(y, x)`` in [0, 2π). Pentagon normals are the cyclic permutations of (0, ±1, ±φ).

    Examples:
        >>> icosahedron(4.0).offsets[[0, 12]].round(4).tolist()
        [3.7569, 3.6598]
    """
    pentagons = _cyclic([(0.0, 1.0, _PHI)])
    hexagons = _cyclic([(1.0, 1.0, 1.0), (1.0 / _PHI, 0.0, _PHI)])
    normals = np.array(pentagons + hexagons)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    # One of the 60 vertices: each touches a pentagon and two hexagons.
    vertex = np.array([0.0, 1.0, 3.0 * _PHI])
    heights = normals @ (vertex * (radius / np.linalg.norm(vertex)))
    return Faces(normals, np.repeat([heights[:12].max(), heights[12:].max()], [12, 20]))


@lru_cache(maxsize=1)
def octant() -> tuple[np.ndarray, np.ndarray]:
    """The faces ``[7]`` whose normals have no negative coordinate, 3 pentagons and 4 hexagons, and all images ``[56]``.

    Mirroring at the planes x = 0, y = 0 and z = 0 maps the solid onto itself, so these 7 stand for all. Each row of 7
    images belongs to one octant: bit 2 of the row mirrors x, bit 1 y, bit 0 z.
    """
    normals = icosahedron(1.0).normals
    first = np.flatnonzero((normals > -1e-9).all(-1))
    corners = np.array([(x, y, z) for x in (1.0, -1.0) for y in (1.0, -1.0) for z in (1.0, -1.0)])
    images = corners[:, None] * normals[first]  # [8, 7, 3]
    return first, (images @ normals.T).argmax(-1).reshape(-1)


@lru_cache(maxsize=1)
def range_image_middles() -> np.ndarray:
    """Unit vectors ``[72, 3]`` through the middles of the range image's cells.

    Azimuths 0, 15, … 345 degrees (0 is forward, 90 left), and of each the elevations -10, 0 and 10 degrees.
    """
    return grid_directions(AZIMUTHS, [(row - (ELEVATIONS - 1) / 2) * ROWS for row in range(ELEVATIONS)])


def grid_directions(azimuths: int, elevations: Sequence[float]) -> np.ndarray:
    """Unit vectors ``[azimuths * len(elevations), 3]`` all around, x forward, y left, z up; ``elevations`` in rad.

    Examples:
        >>> grid_directions(4, (0.0, math.pi / 2)).shape
        (8, 3)
    """
    around = np.arange(azimuths) * (math.tau / azimuths)
    azimuth, elevation = (part.ravel() for part in np.meshgrid(around, np.asarray(elevations), indexing="ij"))
    across = np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], -1)
