"""Which returns of a LiDAR lie where an earlier scan saw through: what is there now has come there."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from uavrl_onboard.geometry import NEAREST_RETURN, is_return, within

MOST_COLUMNS = 0.5  # share that must have had returns, before one that never had any is taken for blind


class Grid(NamedTuple):
    """Cells of a range image, in the sensor's own rows.

    Args:
        rows, columns: how many.
        lowest, highest: elevations of the outermost rows in rad.
    """

    rows: int = 16
    columns: int = 362
    lowest: float = np.radians(-15.0)
    highest: float = np.radians(15.0)

    @classmethod
    def of_elevations(cls, lowest: float, highest: float, coarse: bool = False) -> "Grid":
        """Return the grid for rays between two elevations in degrees, with cells of 2 by 1 degrees.

        ``coarse`` cells are 3 degrees high and 1.5 wide, so that the nine cells around a direction always hold some
        rays of a pattern that changes.

        Examples:
            >>> Grid.of_elevations(-15.0, 15.0) == Grid(), Grid.of_elevations(-7.0, 52.0, coarse=True).rows
            (True, 21)
        """
        if highest - lowest < 2.0:  # one plane
            middle = (lowest + highest) / 2
            lowest, highest = middle - 1.0, middle + 1.0
        rows = max(2, round((highest - lowest) / (3.0 if coarse else 2.0)) + 1)
        columns = 240 if coarse else cls().columns
        return cls(rows=rows, columns=columns, lowest=np.radians(lowest), highest=np.radians(highest))

    def cells(self, points: np.ndarray, ranges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row, with its fraction, and column of each of ``points [3, M]`` at ``ranges [M]``."""
        x, y, z = points
        rise = (self.highest - self.lowest) / (self.rows - 1)
        row = (np.arcsin(np.minimum(np.maximum(z / ranges, -1), 1)) - np.float32(self.lowest)) / np.float32(rise)
        column = np.rint(np.arctan2(-y, x) * np.float32(self.columns / (2 * np.pi))).astype(np.int64)
        return row, np.where(column < 0, column + self.columns, column)


CellIndices = tuple[np.ndarray, np.ndarray]
"""Which returns lie in a grid, and in which of the cells of all clouds in turn."""


class Returns(NamedTuple):
    """The returns of several clouds: coordinates ``[3, M]`` in m, ranges and number of the cloud ``[M]``."""

    points: np.ndarray
    ranges: np.ndarray
    clouds: np.ndarray

    @classmethod
    def of_points(cls, points: np.ndarray, clouds: np.ndarray, max_range: float) -> "Returns":
        """Return the returns among ``points [3, Q]`` of ``clouds [Q]``, as :func:`find_returns` does."""
        points = np.asarray(points, np.float32)
        kept = np.flatnonzero(is_return(points.T, within(max_range)))
        x, y, z = points = points.take(kept, axis=1)
        return cls(points, np.sqrt(x * x + y * y + z * z), clouds.take(kept))

    def in_cells(self, grid: Grid) -> CellIndices:
        """Which of them lie in ``grid``, and in which of all its cells, those of each cloud in turn."""
        row, column = grid.cells(self.points, self.ranges)
        rows = np.rint(row).astype(np.int64)
        inside = np.flatnonzero((rows >= 0) & (rows < grid.rows))
        return inside, ((self.clouds * grid.rows + rows) * grid.columns + column).take(inside)


def find_returns(clouds: np.ndarray, max_range: float) -> Returns:
    """The returns of ``clouds [N, ..., 3]``: all points but NaN, infinity, and those in the housing or out of range.

    Examples:
        >>> find_returns(np.array([[[3.0, 0, 0], [np.nan, 0, 0], [0, 0, 0], [0, 13, 0]]], np.float32), 12.0).ranges
        array([3.], dtype=float32)
    """
    clouds = np.asarray(clouds, np.float32)
    kept = np.flatnonzero(is_return(clouds, within(max_range)))
    x, y, z = points = np.stack([clouds[..., axis].reshape(-1).take(kept) for axis in range(3)])
    each = clouds[..., 0].size // max(len(clouds), 1)  # points in a cloud
    return Returns(points, np.sqrt(x * x + y * y + z * z), kept // max(each, 1))


def range_images(seen: Returns, count: int, grid: Grid, cells: CellIndices | None = None) -> np.ndarray:
    """The least range in each cell of ``count`` clouds: ``[count, rows, columns]`` in m, infinite without a return.

    ``cells`` are those of ``seen`` in ``grid``, if they are known.
    """
    inside, at = cells or seen.in_cells(grid)
    images, ranges = np.full(count * grid.rows * grid.columns, np.inf, np.float32), seen.ranges.take(inside)
    while len(at):  # few passes, as few returns share a cell; numpy's minimum.at takes far longer
        images[at] = ranges
        lower = np.flatnonzero(ranges < images.take(at))
        at, ranges = at.take(lower), ranges.take(lower)
    return images.reshape(count, grid.rows, grid.columns)


def least_around(images: np.ndarray) -> np.ndarray:
    """The least of each cell of ``[N, rows, columns]`` and its eight neighbours; columns close a circle.

    Examples:
        >>> least_around(np.array([[[9.0, 9, 9, 9, 1]]]))
        array([[[1., 9., 9., 1., 1.]]])
    """
    least = images.copy()
    np.minimum(least[:, 1:], images[:, :-1], out=least[:, 1:])
    np.minimum(least[:, :-1], images[:, 1:], out=least[:, :-1])
    beside = np.concatenate([least[..., -1:], least, least[..., :1]], -1)
    return np.minimum(np.minimum(beside[..., :-2], beside[..., 2:]), least)


@dataclass
class EarlierScans:
    """The last scans of N sensors as range images, and where each was taken.

    Args:
        count: sensors N.
        depth: scans that are kept.
        grid: of the images.
        max_range: in m; farther returns are not known.
    """

    count: int
    depth: int
    grid: Grid
    max_range: float

    def __post_init__(self) -> None:
        """Makes room."""
        self.least = np.full((self.depth, self.count, self.grid.rows, self.grid.columns), np.inf, np.float32)
        self.rotations = np.zeros((self.depth, self.count, 3, 3), np.float32)
        self.positions = np.zeros((self.depth, self.count, 3), np.float32)
        self.ever = np.zeros((self.count, self.grid.columns), bool)

    def reset(self, which: np.ndarray) -> None:
        """Forgets in which columns the sensors ``which``, ``bool [N]``, have had returns."""
        self.ever[which] = False

    def add(
        self, seen: Returns, cells: CellIndices, rotations: np.ndarray, positions: np.ndarray, which: np.ndarray
    ) -> None:
        """Keeps scans as the newest of the sensors ``which``, ``bool [N]``.

        Args:
            seen: the returns.
            cells: in which they lie.
            rotations: sensor to world, ``[N, 3, 3]``.
            positions: of the sensors in the world, ``[N, 3]`` in m.
            which: who has scanned.
        """
        images = range_images(seen, self.count, self.grid, cells)
        self.ever |= np.isfinite(images).any(1)
        images = least_around(images)
        for kept, new in ((self.least, images), (self.rotations, rotations), (self.positions, positions)):
            if which.all():
                kept[1:], kept[0] = kept[:-1], new
            else:
                kept[1:, which], kept[0, which] = kept[:-1, which], new[which]

    def beyond(self, world: np.ndarray, clouds: np.ndarray, ages: np.ndarray) -> np.ndarray:
        """How much farther than each point earlier scans saw in its direction and around it: ``[M]`` in m.

        NaN where they did not look, or not as far. Without a return in any of nine cells they saw as far as they can,
        but a column that never had one is blind if most others did.

        Args:
            world: ``[3, M]``, points in the world in m.
            clouds: ``[M]``, whose they are, in rising order.
            ages: ``[N]``, which scan is asked, 1 the newest.
        """
        points, bounds = np.empty_like(world, np.float32), np.searchsorted(clouds, np.arange(self.count + 1))
        for one, (first, last) in enumerate(pairwise(bounds)):
            if first < last:
                turn, place = self.rotations[ages[one] - 1, one].T, self.positions[ages[one] - 1, one]
                points[:, first:last] = turn @ (world[:, first:last] - place[:, None])
        x, y, z = points
        ranges = np.sqrt(x * x + y * y + z * z)
        row, column = self.grid.cells(points, np.maximum(ranges, 1e-6))
        rows = np.minimum(np.maximum(np.rint(row).astype(np.int64), 0), self.grid.rows - 1)
        images = (ages - 1) * self.count + np.arange(self.count)  # each sensor's, among all
        rows += np.repeat(images * self.grid.rows, np.diff(bounds))
        least = self.least.reshape(-1).take(rows * self.grid.columns + column)
        known = (row >= 0) & (row <= self.grid.rows - 1) & (ranges < self.max_range) & (ranges > NEAREST_RETURN)
        if not (seeing := self.ever | (self.ever.mean(1, keepdims=True) < MOST_COLUMNS)).all():
            known &= seeing[clouds, column]
        return np.where(known, np.minimum(least, self.max_range) - ranges, np.float32(np.nan))
