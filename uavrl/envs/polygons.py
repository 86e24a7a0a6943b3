"""Faces with more than three corners: trimesh cuts them into a fan, which can fill the openings of those not convex."""

from array import array
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

MOST_FILLED = 0.01  # of a face's area: what a fan may cover outside of the face, as scanned and sculpted meshes have it
OPENING = 0.05  # m², which is more than a fan may cover outside of any face: nothing flies through less
_AT_ONCE = 100_000  # polygons
_CORNERS = ("vertex_indices", "vertex_index")  # what the list of a PLY's face is called


def count_filled(points: np.ndarray, polygons: np.ndarray | Sequence[np.ndarray], opening: float = OPENING) -> int:
    """Count the polygons that a fan does not fit, given by the numbers of their corners among ``points [P, 3]``.

    An array ``[F, N]`` holds F polygons of N corners. ``opening`` is the least area that must stay open.

    Examples:
        >>> square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0.5, 0.5, 0]])
        >>> count_filled(square, [np.array([0, 1, 2, 3]), np.array([0, 1, 2, 4])])
        0
        >>> count_filled(square, [np.array([1, 4, 3, 0])])
        1
    """
    if isinstance(polygons, np.ndarray) and polygons.ndim == 2:
        sizes = {polygons.shape[1]: polygons}
    else:
        lists: dict[int, list[np.ndarray]] = {}
        for polygon in polygons:
            lists.setdefault(len(polygon), []).append(polygon)
        sizes = {size: np.array(same) for size, same in lists.items()}
    parts = (
        same[first : first + _AT_ONCE]
        for size, same in sizes.items()
        if size > 3
        for first in range(0, len(same), _AT_ONCE)
    )
    return sum(int(_is_filled(points[part], opening).sum()) for part in parts)


def _is_filled(corners: np.ndarray, opening: float) -> np.ndarray:
    """Tell in which polygons ``[K, N, 3]`` the fan from the first corner has triangles that point the other way."""
    spokes = corners[:, 1:] - corners[:, :1]
    triangles = np.cross(spokes[:, :-1], spokes[:, 1:])
    whole = triangles.sum(1)
    area = np.linalg.norm(whole, axis=-1)
    along = np.einsum("kni,ki->kn", triangles, whole / np.maximum(area, 1e-300)[:, None])
    return -np.minimum(along, 0.0).sum(1) > np.minimum(MOST_FILLED * area, 2 * opening)  # all of them twice


def filled_in_obj(file: BinaryIO, opening: float = OPENING) -> int:
    """Count the faces that a fan does not fit, of an OBJ with plain lines."""
    points = array("d")
    faces: dict[int, array[int]] = {}
    for line in file:
        if line.startswith(b"v "):
            points.extend(map(float, line.split()[1:4]))
        elif line.startswith(b"f ") and len(words := line.split()) > 4:
            corners = (int(word) - 1 for word in words[1:])
            faces.setdefault(len(words) - 1, array("q")).extend(corners)
    file.seek(0)
    places = np.array(points).reshape(-1, 3)
    return sum(count_filled(places, np.array(same).reshape(-1, size), opening) for size, same in faces.items())


def polygons_of_ply(raw: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray | Sequence[np.ndarray], bool]:
    """Return corners and faces of a PLY as trimesh keeps them, and whether it read all corners of each face."""
    none = np.zeros((0, 3), np.int64)
    data, corners = raw.get("face", {}).get("data"), raw.get("vertex", {}).get("data")
    if data is None or corners is None:
        return np.zeros((0, 3)), none, True
    points = np.column_stack([np.asarray(corners[axis], float).ravel() for axis in "xyz"])
    names = tuple(data) if isinstance(data, Mapping) else tuple(data.dtype.names or ())
    name = next((name for name in _CORNERS if name in names), None)
    if name is None and isinstance(data, np.ndarray) and len(names) == 1:
        name = names[0]  # which trimesh takes, whatever it is called
    if name is None:
        return points, none, True
    if isinstance(data, Mapping):  # of an ASCII file: [F, N], arrays of different lengths, or [N] of a single face
        found = data[name]
        alone = isinstance(found, np.ndarray) and found.ndim == 1 and found.dtype != object
        return points, found[None] if alone else found, True
    found = data[name]
    if found.dtype.names != ("f0", "f1"):  # how many corners a face has, and which
        return points, none, True
    return points, found["f1"], found["f1"].ndim == 2 and bool((found["f0"] == found["f1"].shape[1]).all())
