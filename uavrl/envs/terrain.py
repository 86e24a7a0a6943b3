"""The valley's ground: a height field with raised walls at its border."""

from dataclasses import dataclass

import numpy as np

from uavrl_onboard.mesh import Mesh

GRID_STEP = 0.4  # m between two heights of the field
TILE_CELLS = 64  # along each side of a mesh of the surface: 8,192 triangles
FLOOR_AMPLITUDE = 0.5  # m, the floor stays within ± this
WALL_HEIGHT = 7.0  # m, mean height of the walls at the border
WALL_WIDTH = 2.5  # m, mean width of the slope from the floor to the top of the wall


@dataclass(frozen=True)
class HeightField:
    """Heights over a regular grid around the origin, triangulated."""

    heights: np.ndarray
    size: tuple[float, float]

    def at(self, xy: np.ndarray) -> np.ndarray:
        """Returns the ground's height ``[N]`` in metres at ``xy [N, 2]``, that of the border beyond it."""
        return interpolate(self.heights[None], self.size, np.zeros(len(xy), dtype=np.int64), xy)

    def tiles(self) -> list[Mesh]:
        """Returns the surface as meshes for PyBullet, every cell cut along its (0, 0)–(1, 1) diagonal."""
        tile_x, tile_y = (np.arange(n - 1) // TILE_CELLS for n in self.heights.shape)
        across, along = np.meshgrid(*grid_axes(self.heights.shape, self.size), indexing="ij")
        index = np.arange(self.heights.size).reshape(self.heights.shape)
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        faces = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
        mesh = Mesh(np.stack([across, along, self.heights], -1).reshape(-1, 3), faces)
        return mesh.split(np.tile(np.add.outer(tile_x * len(tile_y), tile_y).ravel(), 2))


def grid_axes(shape: tuple[int, ...], size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the grid's x ``[X]`` and y ``[Y]`` in metres."""
    return np.linspace(-size[0] / 2, size[0] / 2, shape[0]), np.linspace(-size[1] / 2, size[1] / 2, shape[1])


def interpolate(heights: np.ndarray, size: tuple[float, float], field: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Returns the height ``[N]`` of the surfaces ``heights [V, X, Y]`` at ``xy [N, 2]`` of the fields ``field [N]``."""
    cells = np.array(heights.shape[1:]) - 1
    scaled = np.clip((np.asarray(xy) / np.asarray(size) + 0.5) * cells, 0, cells)
    corner = np.minimum(scaled.astype(np.int64), cells - 1)
    u, v = (scaled - corner).T
    i, j = corner.T
    low, high = heights[field, i, j], heights[field, i + 1, j + 1]
    middle = np.where(u >= v, heights[field, i + 1, j], heights[field, i, j + 1])
    return low + np.maximum(u, v) * (middle - low) + np.minimum(u, v) * (high - middle)


def smooth_noise(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, wavelength: tuple[float, float]) -> np.ndarray:
    """Returns a sum of plane waves in random directions at ``x`` and ``y``, scaled to reach exactly ±1 somewhere."""
    total = np.zeros_like(x)
    for _ in range(12):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        length = rng.uniform(*wavelength)
        total += length * np.cos(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / length + phase)
    return total / np.abs(total).max()


def valley_ground(rng: np.random.Generator, size: tuple[float, float]) -> HeightField:
    """Returns a valley: a floor within ±0.5 m around 0 and walls of about 7 m at the border.

    Source: Chansuparp (2022), §4.1: a valley of 1200 m² with complex geography. The heights are this library's choice.
    """
    shape = tuple(max(2, round(length / GRID_STEP) + 1) for length in size)
    x, y = np.meshgrid(*grid_axes(shape, size), indexing="ij")
    floor = FLOOR_AMPLITUDE * smooth_noise(rng, x, y, (4.0, 14.0))
    width = WALL_WIDTH + 0.6 * smooth_noise(rng, x, y, (5.0, 15.0))
    top = WALL_HEIGHT + 0.8 * smooth_noise(rng, x, y, (3.0, 10.0))
    towards_x = np.clip(1 - (size[0] / 2 - np.abs(x)) / width, 0, 1)
    towards_y = np.clip(1 - (size[1] / 2 - np.abs(y)) / width, 0, 1)
    slope = np.minimum(np.hypot(towards_x, towards_y), 1)
    share = slope**2 * (3 - 2 * slope)
    return HeightField(floor * (1 - share) + top * share, size)
