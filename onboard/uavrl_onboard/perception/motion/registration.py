"""How a LiDAR turned and moved from one scan to the next, by laying the scans over each other.

Sources: Chen and Medioni (1991), "Object modeling by registration of multiple range images", for the distance from a
point to a plane; Blais and Levine (1995), "Registering multiview range data to create 3D computer objects", for the
point that is met by projection into the other range image; Beaton and Tukey (1974) for the weights, which leave out
what has moved or has just come into sight.
"""

from typing import NamedTuple

import numpy as np

from uavrl_onboard.geometry import rotation_about
from uavrl_onboard.perception.motion.occlusion import CellIndices, Grid, Returns

THINNED = 5  # of the columns, one is looked at
SAMPLES = 256  # points of a scan that are compared
GATES = (1.0, 0.5, 0.25, 0.15)  # m, step by step, up to which a distance from point to plane counts
AGREEING = 0.15  # m, up to which a point lies on the surface that the other scan saw
LEAST_COMPARED = 60  # points; with fewer, the scans say nothing about how the sensor turned
LEAST_AGREEING = 0.92  # of the points that are compared, in scans that lie on each other
MOST_TURN, MOST_SHIFT = np.radians(12.0), 0.4  # m, that the scans may correct what was expected
STARTS = np.radians([5.0, -5.0])  # of yaw, from which it is tried again
EXPECTED = np.array([2.0] * 3 + [200.0] * 3, np.float32)  # weight of what was expected, against one point per m²
EXPECTED_MATRIX = np.diag(EXPECTED)
LONGEST = (1.5, 4.0)  # m, from a point's left to its right neighbour, and from the lower to the upper, on one surface


class Samples(NamedTuple):
    """Points of N scans in the sensor's axes, the surface's normals there ``[N, 3, S]``, and how many there were."""

    points: np.ndarray
    normals: np.ndarray
    found: np.ndarray


class Alignment(NamedTuple):
    """Where N sensors were in the axes of their earlier scans: rotations ``[N, 3, 3]``, places ``[N, 3]`` in m.

    ``compared [N]`` is how many points were, ``agreeing [N]`` the share of them that lies on what the earlier scan saw,
    and ``fits [N]`` whether that is enough.
    """

    rotations: np.ndarray
    places: np.ndarray
    compared: np.ndarray
    fits: np.ndarray
    agreeing: np.ndarray


def point_images(seen: Returns, count: int, grid: Grid, cells: CellIndices | None = None) -> np.ndarray:
    """The return in each cell of ``count`` clouds, ``[3, count, rows, columns]`` in m; zeros without one.

    ``cells`` are those of ``seen`` in ``grid``, if they are known.
    """
    inside, at = cells or seen.in_cells(grid)
    images = np.zeros((3, count * grid.rows * grid.columns), np.float32)
    for image, axis in zip(images, seen.points, strict=True):
        image[at] = axis.take(inside)
    return images.reshape(3, count, grid.rows, grid.columns)


def sample(images: np.ndarray, count: int = SAMPLES) -> Samples:
    """``count`` points of ``images [3, N, rows, columns]``, spread evenly, with normals from the cells around them.

    The scans of a sensor with one layer of beams, in two rows, have no normals, so nothing is found in them.
    """
    if images.shape[2] < 3:
        nothing = np.zeros((images.shape[1], 3, count), np.float32)
        return Samples(nothing, nothing, np.zeros(images.shape[1], np.int64))
    middle = np.arange(0, images.shape[-1], THINNED)
    inner = images[:, :, 1:-1]
    left, right = (inner.take((middle + side) % images.shape[-1], axis=-1) for side in (-1, 1))
    points = inner[..., ::THINNED]
    lower, upper = images[:, :, :-2, ::THINNED], images[:, :, 2:, ::THINNED]
    across, along = right - left, upper - lower
    valid = ((across**2).sum(0) < LONGEST[0] ** 2) & ((along**2).sum(0) < LONGEST[1] ** 2)
    for each in (points, left, right, lower, upper):
        valid &= each[0] != 0
    valid = valid.reshape(len(valid), -1)
    found = valid.sum(1)
    order = np.flatnonzero(valid)
    rank = (np.cumsum(found) - found)[:, None] + np.arange(count) * found[:, None] // count
    chosen = order.take(np.minimum(rank, len(order) - 1)) if len(order) else np.zeros(rank.shape, np.int64)
    points, across, along = (
        values.reshape(3, -1).take(chosen, axis=1).transpose(1, 0, 2) for values in (points, across, along)
    )
    normals = _cross(across, along)
    length = np.sqrt((normals**2).sum(1, keepdims=True))
    return Samples(points, normals / np.maximum(length, 1e-6), found)


def register(samples: Samples, images: np.ndarray, grid: Grid, rotations: np.ndarray, places: np.ndarray) -> Alignment:
    """Lays scans over earlier ones by Gauss-Newton steps, from where they are expected.

    Args:
        samples: of the scans.
        images: of the earlier ones, ``[3, N, rows, columns]``.
        grid: of these images.
        rotations: as expected, from the sensor's axes to those of its earlier scan, ``[N, 3, 3]``.
        places: as expected, of the sensor in these axes, ``[N, 3]`` in m.
    """
    turn, place = rotations.astype(np.float32), places.astype(np.float32)
    compared = _compare(samples, images, grid, turn, place)
    told = _judge(samples, compared, turn, place)
    found = Alignment(*(values.copy() for values in told))
    if len(off := np.flatnonzero(told.agreeing < 1)):  # nothing can lie better than the others
        first = Compared(*(values[off] for values in compared))
        refined = _refine(_of(samples, off), images[:, off], grid, rotations[off], places[off], first)
        for kept, new in zip(found, refined, strict=True):
            kept[off] = new
    for start in STARTS:  # for scans that lie farther from what was expected than one descent reaches
        if len(bad := np.flatnonzero(~found.fits & (found.compared >= LEAST_COMPARED))):
            turned = rotation_by(np.array([[0.0, 0.0, start]])) @ rotations[bad]
            again = _refine(_of(samples, bad), images[:, bad], grid, turned, places[bad])
            better = bad[again.fits]
            for kept, new in zip(found, again, strict=True):
                kept[better] = new[again.fits]
    right = told.agreeing >= found.agreeing  # what was expected lies as well: nothing is to be corrected
    for kept, expected in zip(found, told, strict=True):
        kept[right] = expected[right]
    turned = np.arccos(np.clip((np.einsum("nij,nij->n", found.rotations, rotations) - 1) / 2, -1, 1))
    small = (turned < MOST_TURN) & (np.linalg.norm(found.places - places, axis=1) < MOST_SHIFT)
    return Alignment(found.rotations, found.places, found.compared, found.fits & small, found.agreeing)


def _of(samples: Samples, scans: np.ndarray) -> Samples:
    """The samples of some ``scans``."""
    return Samples(*(values[scans] for values in samples))


class Compared(NamedTuple):
    """Points and normals in the earlier axes ``[N, 3, S]``, how far the surfaces there lie from them, and where known.

    ``distances`` and ``known`` are ``[N, S]``.
    """

    points: np.ndarray
    normals: np.ndarray
    distances: np.ndarray
    known: np.ndarray


def _refine(
    samples: Samples,
    images: np.ndarray,
    grid: Grid,
    rotations: np.ndarray,
    expected: np.ndarray,
    first: Compared | None = None,
) -> Alignment:
    """The steps from one start, whose comparison may be known; the places stay near those that are ``expected``."""
    turn, place = rotations.astype(np.float32), expected.astype(np.float32)
    compared = _compare(samples, images, grid, turn, place) if first is None else first
    for gate in GATES:
        points, normals, distances, known = compared
        weights = np.where(known, np.maximum(1 - (distances / gate) ** 2, 0) ** 2, 0)
        slopes = np.concatenate([_cross(points, normals), normals], 1)
        weighted = slopes * weights[:, None]
        pull = np.concatenate([np.zeros_like(place), expected - place], 1) * EXPECTED
        matrix = weighted @ slopes.transpose(0, 2, 1) + EXPECTED_MATRIX
        step = np.linalg.solve(matrix, weighted @ distances[..., None] + pull[..., None])[..., 0]
        turned = rotation_by(step[:, :3]).astype(np.float32)
        turn, place = turned @ turn, ((turned @ place[..., None])[..., 0] + step[:, 3:]).astype(np.float32)
        compared = _compare(samples, images, grid, turn, place)
    return _judge(samples, compared, turn, place)


def _judge(samples: Samples, compared: Compared, turn: np.ndarray, place: np.ndarray) -> Alignment:
    """How well scans lie on the earlier ones where they are said to be."""
    known = compared.known
    count = known.sum(1)
    agreeing = (known & (np.abs(compared.distances) < AGREEING)).sum(1) / np.maximum(count, 1)
    return Alignment(turn, place, np.minimum(count, samples.found), agreeing >= LEAST_AGREEING, agreeing)


def _compare(samples: Samples, images: np.ndarray, grid: Grid, turn: np.ndarray, place: np.ndarray) -> Compared:
    """Lay samples over the earlier scans."""
    points, normals = turn @ samples.points + place[..., None], turn @ samples.normals
    x, y, z = axes = points.transpose(1, 0, 2)
    row, column = grid.cells(axes, np.maximum(np.sqrt(x * x + y * y + z * z), 1e-6))
    rows = np.rint(row).astype(np.int64)
    known = (samples.found > 0)[:, None] & (rows >= 0) & (rows < grid.rows)
    at = (np.arange(len(turn))[:, None] * grid.rows + np.minimum(np.maximum(rows, 0), grid.rows - 1)) * grid.columns
    met = images.reshape(3, -1).take(at + column, axis=1).transpose(1, 0, 2)
    known &= met[:, 0] != 0
    return Compared(points, normals, (normals * (met - points)).sum(1), known)


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The cross products of ``[N, 3, S]``."""
    (a, b, c), (x, y, z) = first.transpose(1, 0, 2), second.transpose(1, 0, 2)
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], 1)


def rotation_by(vectors: np.ndarray) -> np.ndarray:
    """Return the rotations ``[N, 3, 3]`` by vectors ``[N, 3]``, whose lengths are the angles in rad."""
    angles = np.linalg.norm(vectors, axis=-1)
    return rotation_about(vectors / np.maximum(angles, 1e-12)[:, None], angles)


def orthonormal(rotations: np.ndarray) -> np.ndarray:
    """Rotations ``[N, 3, 3]`` without the rounding that they have gathered."""
    return rotations @ (3 * np.eye(3) - rotations.transpose(0, 2, 1) @ rotations) / 2
