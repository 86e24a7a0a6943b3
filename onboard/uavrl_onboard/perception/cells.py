"""Where the cells of the two LiDAR reductions lie, and which points count: numpy alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import NEAREST_RETURN, spherical

Statistic = Literal["face", "range", "proximity"]

NUM_FACES = 32
"""Faces of the truncated icosahedron, 12 pentagons and then 20 hexagons."""

LARGEST_RADIUS = 1e6  # m: the squares of much larger ones overflow
TOUCHING = 1e-6  # of the radius: what a cell reads that a point touches, as 0 means "no point"
LASERS = 16
"""Of a VLP-16, fired in turn: a scan is 1808 such firing cycles."""
AZIMUTH_STEP = 2.0 * math.pi * 10.0 * 55.296e-6  # rad from one firing cycle to the next at 10 Hz: 0.1991°
FAR_EVERY = 5  # of the firing cycles, which look farther than the cells: one to a degree
# The ball stops this much (relative, squared) short of its radius, so that float32 rounding cannot let in a point that
# a sensor whose range ends at the radius does not report; and it begins this much after the housing.
_ROUNDING = 2e-6

MOST_CELLS = 10_000  # of a range image
_LAYER = 5.0  # degrees beside a single layer of rays that count as its row
_LEVELS = 256  # elevations of rays that a row's border is kept away from; of a sensor with more, rows are equal
_VLP16, _VLP16_BORDERS = (3, (-15.0, 15.0)), (-4.0, 4.0)  # half-way between lasers: at ±5 rounding would choose

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


@dataclass(frozen=True)
class RangeGrid:
    """The cells of a range image: columns of azimuth all around the sensor, and in each of them rows of elevation.

    Cell ``rows * column + row`` is in a column, counted to the left from the one straight ahead, and in a row, counted
    from the lowest. The default fits a VLP-16: 24 columns of 15 degrees, and rows whose middles are at -10, 0 and 10
    degrees, with borders a degree from any laser.

    Args:
        columns: of equal width.
        rows: in a column.
        elevation: the lowest and the highest elevation of the sensor's field of view, degrees. Points beyond them
            belong to the lowest or the highest row, unless a reduction leaves them out by its ``view``.
        borders: elevations between the rows, ascending, degrees; None for equal rows (the default grid: ±4). Keep them
            away from the sensor's lasers, where rounding would choose the row.

    Raises:
        UavrlError: for sizes out of range, and for elevations that are not ascending within [-90, 90].

    Examples:
        >>> RangeGrid().row_borders, RangeGrid().middles
        ((-4.0, 4.0), (-10.0, 0.0, 10.0))
        >>> RangeGrid(columns=36, rows=4, elevation=(-25.0, 15.0)).middles
        (-20.0, -10.0, 0.0, 10.0)
    """

    columns: int = 24
    rows: int = 3
    elevation: tuple[float, float] = (-15.0, 15.0)
    borders: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        """Checks the sizes; borders that are the default's are not kept, so that equal grids are equal."""
        if not all(isinstance(size, int | np.integer) for size in (self.columns, self.rows)):
            raise UavrlError(
                f"A range image has whole numbers of columns and rows, got columns={self.columns!r} and "
                f"rows={self.rows!r}."
            )
        if min(self.columns, self.rows) < 1 or self.columns * self.rows > MOST_CELLS:
            raise UavrlError(
                f"A range image has at least one column and one row and at most {MOST_CELLS:,} cells, got "
                f"columns={self.columns} and rows={self.rows}."
            )
        try:
            low, high = map(float, self.elevation)
        except (TypeError, ValueError) as error:
            raise UavrlError(
                f"elevation must be the lowest and the highest elevation in degrees, for example (-15, 15), got "
                f"{self.elevation!r}."
            ) from error
        object.__setattr__(self, "elevation", (low, high))
        borders = self._default_borders() if self.borders is None else tuple(map(float, self.borders))
        ascending = all(a < b for a, b in pairwise([low, *borders, high]))
        if len(borders) != self.rows - 1 or not ascending or not -90.0 <= low < high <= 90.0:
            raise UavrlError(
                f"A range image of {self.rows} rows needs two elevations in [-90, 90] degrees and {self.rows - 1} "
                f"borders between them, all ascending, got elevation={self.elevation} and borders={self.borders}."
            )
        object.__setattr__(self, "borders", None if borders == self._default_borders() else borders)

    @classmethod
    def for_sensor(cls, rays: np.ndarray, columns: int = 24, rows: int = 3) -> "RangeGrid":
        """Returns the grid for the field of view of a sensor whose rays fly in the directions ``rays [R, 3]``.

        Its rows share the elevations of the rays equally, with each border half-way between two lasers. The row of a
        sensor with a single layer reaches 5 degrees above and below it.

        Raises:
            UavrlError: for directions that are none, and for more rows than the sensor's lasers fill.

        Examples:
            >>> beams = grid_directions(360, np.radians([-25.0, -15.0, -5.0, 5.0, 15.0]))
            >>> grid = RangeGrid.for_sensor(beams, columns=36, rows=2)
            >>> grid.elevation, grid.row_borders
            ((-25.0, 15.0), (-10.0,))
        """
        levels = np.unique(elevations_of(rays).round(2))  # a hundredth of a degree: rounding makes no lasers
        low, high = float(levels[0]), float(levels[-1])
        if len(levels) < rows:
            raise UavrlError(f"Expected rays at {rows} elevations or more for {rows} rows, got {len(levels)}.")
        if len(levels) == 1:
            return cls(columns, rows, (max(low - _LAYER, -90.0), min(high + _LAYER, 90.0)))
        equal = low + np.arange(1, rows) * (high - low) / rows
        if len(levels) > _LEVELS:
            return cls(columns, rows, (low, high), tuple(equal.tolist()))
        between = (levels[1:] + levels[:-1]) / 2
        distance = np.abs(between - equal[:, None]).round(6) + 1e-7 * np.abs(between - (low + high) / 2)
        borders = between[distance.argmin(-1)] if rows > 1 else equal  # of two alike the one nearer to the middle
        if len(np.unique(borders)) < len(borders):
            raise UavrlError(f"The sensor has no rays in some of {rows} equal rows: take fewer rows, or pass borders.")
        return cls(columns, rows, (low, high), tuple(borders.round(6).tolist()))

    def _equal(self, places: np.ndarray) -> tuple[float, ...]:
        """Elevations at ``places`` rows from the lowest elevation, degrees."""
        low, high = self.elevation
        return tuple((low + places * ((high - low) / self.rows)).tolist())

    def _default_borders(self) -> tuple[float, ...]:
        return _VLP16_BORDERS if (self.rows, self.elevation) == _VLP16 else self._equal(np.arange(1.0, self.rows))

    @property
    def count(self) -> int:
        """The number of cells."""
        return self.columns * self.rows

    @property
    def row_borders(self) -> tuple[float, ...]:
        """The elevations between the rows, degrees."""
        return self._default_borders() if self.borders is None else self.borders

    @property
    def middles(self) -> tuple[float, ...]:
        """The elevations of the rows' middles, degrees.

        They are those of equal rows if the borders lie between these, else half-way between the borders.
        """
        edges, equal = np.array([self.elevation[0], *self.row_borders, self.elevation[1]]), np.arange(self.rows) + 0.5
        middles = np.array(self._equal(equal))
        if ((edges[:-1] < middles) & (middles < edges[1:])).all():
            return tuple(middles.tolist())
        return tuple(((edges[:-1] + edges[1:]) / 2).tolist())


VLP16_GRID = RangeGrid()
"""24 columns and 3 rows: the cells of the packaged policies."""


def elevations_of(rays: np.ndarray) -> np.ndarray:
    """The elevations of directions ``[R, 3]``, degrees; UavrlError for what are none.

    Examples:
        >>> elevations_of(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 2.0]])).tolist()
        [0.0, 90.0]
    """
    rays = np.asarray(rays, np.float64)
    if rays.ndim != 2 or rays.shape[1] != 3 or not len(rays) or not np.isfinite(rays).all() or not rays.any(-1).all():
        raise UavrlError(
            f"Expected the directions of a sensor's rays, finite [R, 3] and not 0, got {list(rays.shape)}."
        )
    return np.degrees(np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])))


@lru_cache(maxsize=16)
def range_image_middles(grid: RangeGrid = VLP16_GRID) -> np.ndarray:
    """Unit vectors ``[cells, 3]`` through the middles of a range image's cells.

    Of the default grid: azimuths 0, 15, … 345 degrees (0 is forward, 90 left), and of each the elevations -10, 0 and 10
    degrees.
    """
    return grid_directions(grid.columns, np.radians(grid.middles).tolist())


def grid_directions(azimuths: int, elevations: Sequence[float]) -> np.ndarray:
    """Unit vectors ``[azimuths * len(elevations), 3]`` all around, x forward, y left, z up; ``elevations`` in rad.

    Examples:
        >>> grid_directions(4, (0.0, math.pi / 2)).shape
        (8, 3)
    """
    around = np.arange(azimuths) * (math.tau / azimuths)
    azimuth, elevation = (part.ravel() for part in np.meshgrid(around, np.asarray(elevations), indexing="ij"))
    return spherical(azimuth, elevation)
