"""Which rays of a short-range scan can hit anything at all: most cannot, and need no ray casting."""

import math
from collections.abc import Iterator, Sequence
from functools import reduce

import numpy as np

from uavrl.envs.sensors import LidarSensor
from uavrl_onboard.lidar.vlp16 import AZIMUTH_STEP, AZIMUTH_STEPS, LASER_ELEVATIONS
from uavrl_onboard.mesh import Mesh

__all__ = ["RayCuller"]

_SPHERE = 0.27  # m: triangles that need a larger bounding sphere are cut up
_CHUNK = 8192  # triangles that are cut up together: they fit into a processor's cache
_BAND = 20.0  # m, along y: a vehicle looks at the spheres of one band or two
_NONE = np.empty(0, np.int64)


class RayCuller:
    """Finds the rays of a short-range scan that pass near a triangle within range.

    Each triangle in reach is seen as its bounding sphere (large ones as several), which covers an interval of azimuths
    and an interval of elevations. The rays in none of these rectangles cannot hit, and need not be cast. A VLP-16's
    rays come in a grid of their own: firing cycles at even azimuth steps, clockwise from straight ahead, times lasers
    at even elevation steps. The rays of any other sensor are sorted into cells of azimuth and elevation.
    """

    _BIN = 8  # firing cycles that are kept or dropped together
    _CELL = math.radians(1.5)  # of a sensor without such a grid

    def __init__(self, mesh: Mesh, max_range: float, sensor: LidarSensor) -> None:
        centres, radii = _spheres_around(mesh)
        bands = np.floor(centres[1] / _BAND)
        wide = 2.0 * np.abs(centres[0]).max(initial=0.0) + 1.0  # m: no two values of x are so far apart
        order = np.argsort(bands * wide + centres[0])  # by band and then by x: a range of x in a band is a slice
        self._centres, bands = np.ascontiguousarray(centres[:, order], dtype=np.float32), bands[order]  # [3, S]
        self._bands = {int(b): slice(*np.searchsorted(bands, [b, b + 1])) for b in np.unique(bands)}
        margin = max(1e-4, 1e-6 * float(np.abs(centres).max(initial=0.0)))  # float32 rounding stays within
        self._radii = (radii[order] * 1.001 + margin).astype(np.float32)
        window = max_range + self._radii.max(initial=0.0)
        self._window = np.array([-window, window], np.float32)
        self._reach = (max_range + self._radii) ** 2
        self._places: list[np.ndarray] = []  # of each scan of the pattern, the cell of each ray
        if sensor.fires_as_vlp16 and sensor.stride == 1:
            elevations = np.radians(LASER_ELEVATIONS)
            self._bins, self._width = AZIMUTH_STEPS // self._BIN, AZIMUTH_STEP * self._BIN
            self._lowest, self._highest = float(elevations.min()), float(elevations.max())
            self._rise = (self._highest - self._lowest) / (len(elevations) - 1)
            self._rows, self._by_elevation = len(elevations), np.argsort(np.argsort(elevations))
            self._depth = 0.0  # a row is a line
        else:
            self._sort(sensor.rays.directions)

    def _sort(self, directions: np.ndarray) -> None:
        """Sorts the rays ``[S, R, 3]`` into cells."""
        x, y, z = np.moveaxis(directions.astype(np.float64), -1, 0)
        elevation, azimuth = np.arctan2(z, np.hypot(x, y)), np.arctan2(-y, x) % math.tau
        self._bins = round(math.tau / self._CELL)
        self._width = math.tau / self._bins
        self._lowest, self._highest = float(elevation.min()) - 1e-4, float(elevation.max()) + 1e-4
        self._rows = max(1, math.ceil((self._highest - self._lowest) / self._CELL))
        self._rise = (self._highest - self._lowest) / self._rows
        self._depth = 1.0  # a row reaches up to the next one
        column = (azimuth / self._width).astype(np.int64) % self._bins
        row = ((elevation - self._lowest) / self._rise).astype(np.int64).clip(0, self._rows - 1)
        self._places = list(column * self._rows + row)

    def candidates(self, positions: np.ndarray, rotations: np.ndarray, numbers: Sequence[int]) -> np.ndarray:
        """Returns which rays can hit, ``bool [N, R]``.

        Args:
            positions: ``[N, 3]``, sensor positions in the world in metres.
            rotations: ``[N, 3, 3]``, sensor-to-world rotations.
            numbers: which scan of the sensor's pattern each casts.
        """
        vehicles, (x, y, z), flat, radii = self._near(positions.astype(np.float32), rotations.astype(np.float32))
        far = np.sqrt(flat * flat + z * z)
        half_azimuth, half_elevation = (
            np.where(radii < away, np.arcsin(np.minimum(radii / np.maximum(away, 1e-9), 1.0)), np.pi)
            for away in (flat, far)
        )
        azimuth, elevation = np.arctan2(-y, x), np.arctan2(z, flat) - self._lowest
        bottom = np.ceil((elevation - half_elevation) / self._rise - self._depth)
        bottom = bottom.clip(0, self._rows).astype(np.int64)
        top = np.floor((elevation + half_elevation) / self._rise + 1.0).clip(bottom, self._rows).astype(np.int64)
        # A whole turn may begin less than one step before the first bin.
        left = np.floor((azimuth - half_azimuth) / self._width).astype(np.int64).clip(-self._bins)
        # The cycles may end a step short of a full turn: bins counted backwards from straight ahead are off by that.
        right = np.floor((azimuth + half_azimuth) / self._width + 1.0 / self._BIN).astype(np.int64) + 1
        bins = self._painted(len(positions), vehicles, left, right, bottom, top)
        if self._places:
            cells = bins.reshape(len(positions), -1)
            found = np.empty((len(positions), len(self._places[0])), bool)
            for row, number in enumerate(numbers):
                found[row] = cells[row].take(self._places[number])
            return found
        grid = np.repeat(bins[:, :, self._by_elevation], self._BIN, axis=1)
        return grid.reshape(len(grid), -1) if len(grid) else np.zeros((0, AZIMUTH_STEPS * self._rows), bool)

    def _near(self, positions: np.ndarray, rotations: np.ndarray) -> tuple[np.ndarray, ...]:
        """Returns the spheres in range and between the outermost rays' cones.

        That is vehicle ids ``[M]``, centres in the sensor frame ``[3, M]``, their distances from its z axis ``[M]``
        and radii ``[M]``.
        """
        found = [np.empty((6, 0), np.float32)]
        for vehicle, (position, rotation) in enumerate(zip(positions, rotations, strict=True)):
            near = np.concatenate([_NONE, *(self._within(window, position) for window in self._windows(position))])
            x, y, z = rotation.T @ (self._centres.take(near, axis=1) - position[:, None])
            radii = self._radii.take(near)
            flat = np.sqrt(x * x + y * y)
            over = math.cos(self._highest) * z - math.sin(self._highest) * flat  # m above the highest ray's cone
            under = math.sin(self._lowest) * flat - math.cos(self._lowest) * z
            seen = np.flatnonzero((over < radii) & (under < radii))
            found.append(np.stack([np.full_like(x, vehicle), x, y, z, flat, radii]).take(seen, axis=1))
        spheres = np.concatenate(found, axis=1)
        return spheres[0].astype(np.int64), spheres[1:4], spheres[4], spheres[5]

    def _windows(self, position: np.ndarray) -> Iterator[slice]:
        """The spheres that may be in range: in each band along y, a range of x."""
        lowest, highest = np.floor((position[1] + self._window) / _BAND).astype(np.int64)
        for band in range(lowest, highest + 1):
            if (inside := self._bands.get(band)) is not None:
                first, last = np.searchsorted(self._centres[0, inside], position[0] + self._window)
                yield slice(inside.start + first, inside.start + last)

    def _within(self, window: slice, position: np.ndarray) -> np.ndarray:
        """The places of those spheres of a window that are in range."""
        x, y, z = (at - here for at, here in zip(self._centres[:, window], position, strict=True))
        return window.start + np.flatnonzero(x * x + y * y + z * z < self._reach[window])

    def _painted(
        self, num: int, vehicles: np.ndarray, left: np.ndarray, right: np.ndarray, bottom: np.ndarray, top: np.ndarray
    ) -> np.ndarray:
        """Returns the union of rectangles ``[left, right) x [bottom, top)`` per vehicle, ``bool [N, bins, rows]``.

        Rectangles are written as steps at their corners and summed up. Azimuth bins wrap around: a rectangle that
        reaches beyond the last bin begins a second time at bin 0.
        """
        turned = self._bins * (left < 0)
        left, right = left + turned, np.minimum(right - left, self._bins) + left + turned
        row, columns = vehicles * self._bins, self._rows + 1
        beyond = np.flatnonzero(right >= self._bins)
        begins = np.concatenate([row + left, row[beyond]]) * columns
        ends = (row + right - self._bins * (right >= self._bins)) * columns
        bottoms, tops = (np.concatenate([side, side[beyond]]) for side in (bottom, top))
        size = num * self._bins * columns
        steps = np.bincount(np.concatenate([begins + bottoms, ends + top]), minlength=size)
        steps -= np.bincount(np.concatenate([begins + tops, ends + bottom]), minlength=size)
        return steps.reshape(num, self._bins, columns)[:, :, :-1].cumsum(axis=2).cumsum(axis=1) > 0


def _spheres_around(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Centres ``float64 [3, S]`` and radii ``[S]`` of spheres that cover a mesh; no radius exceeds ``_SPHERE``."""
    centres, radii = [np.empty((3, 0))], [np.empty(0, np.float32)]
    for first in range(0, len(mesh.faces), _CHUNK):
        corners = mesh.vertices[mesh.faces[first : first + _CHUNK]].astype(np.float64)
        middle = corners.mean(axis=(0, 1))
        for centre, radius in _cut_spheres((corners - middle).astype(np.float32)):
            centres.append(centre + middle[:, None])
            radii.append(radius)
    return np.concatenate(centres, axis=1), np.concatenate(radii)


def _cut_spheres(corners: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Cuts triangles ``[T, 3, 3]`` in two at the middle of their longest edge until small spheres hold the pieces.

    Yields the centres ``[3, S]`` and the radii ``[S]`` of the spheres around those that are small enough. This is
    `uavrl.envs.mesh.cut_up` on columns in single precision, which takes a third of the time.
    """
    a, b, c = np.ascontiguousarray(corners.transpose(1, 2, 0))  # [3, T] each
    while a.shape[1]:
        middle = (np.minimum(np.minimum(a, b), c) + np.maximum(np.maximum(a, b), c)) / 2.0
        squared = reduce(np.maximum, (_squared(corner - middle) for corner in (a, b, c)))
        small = squared <= _SPHERE**2
        yield middle[:, small], np.sqrt(squared[small])
        a, b, c = (corner[:, ~small] for corner in (a, b, c))
        ab, bc, ca = _squared(b - a), _squared(c - b), _squared(a - c)
        turn_b, turn_c = (bc > ab) & (bc >= ca), (ca > ab) & (ca > bc)
        a, b, c = (
            np.where(turn_c, last, np.where(turn_b, next_one, one))
            for one, next_one, last in ((a, b, c), (b, c, a), (c, a, b))
        )
        half = (a + b) / 2.0  # ab is the longest
        a, b, c = np.hstack([a, half]), np.hstack([half, b]), np.hstack([c, c])


def _squared(vectors: np.ndarray) -> np.ndarray:
    """The squared lengths ``[T]`` of vectors ``[3, T]``."""
    x, y, z = vectors
    return np.asarray(x * x + y * y + z * z)
