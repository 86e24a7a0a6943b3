"""Faces with more than three corners: trimesh cuts them into a fan, which fills the openings of those not convex."""

import mmap
import re
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

SLACK = 0.02  # sine of the angle by which a corner may point inwards, as rounding makes it
_MANY_CORNERS = re.compile(rb"[\r\n][ \t]*f(?:(?:[ \t]|\\\r?\n)+[^\s#\\]+){4}")  # a face of an OBJ


def count_concave(points: np.ndarray, polygons: np.ndarray | Sequence[np.ndarray]) -> int:
    """How many polygons, given by the numbers of their corners among ``points [P, 3]``, are not convex.

    An array ``[F, N]`` holds F polygons of N corners.

    Examples:
        >>> square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0.5, 0.5, 0]])
        >>> count_concave(square, [np.array([0, 1, 2, 3]), np.array([0, 1, 2, 4])])
        0
        >>> count_concave(square, [np.array([0, 1, 4, 3])])
        1
    """
    if isinstance(polygons, np.ndarray) and polygons.ndim == 2:
        return int(_is_concave(points[polygons]).sum()) if polygons.shape[1] > 3 else 0
    sizes: dict[int, list[np.ndarray]] = {}
    for polygon in polygons:
        if len(polygon) > 3:
            sizes.setdefault(len(polygon), []).append(polygon)
    return sum(int(_is_concave(points[np.array(same)]).sum()) for same in sizes.values())


def _is_concave(corners: np.ndarray) -> np.ndarray:
    """Which of the polygons ``[K, N, 3]`` have a corner that points inwards."""
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=-1)
    turns = np.cross(edges, np.roll(edges, -1, axis=1))
    normals = np.cross(corners - corners[:, :1], np.roll(corners, -1, axis=1) - corners[:, :1]).sum(1)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-300)
    inwards = -np.einsum("kni,ki->kn", turns, normals)
    return (inwards > SLACK * lengths * np.roll(lengths, -1, axis=1)).any(1)


def concave_in_obj(file: BinaryIO) -> int:
    """How many faces of an OBJ are not convex; its text is read only if any has more than three corners."""
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if not _MANY_CORNERS.search(content):
            return 0
        lines = content.read().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    words = [line.partition(b"#")[0].split() for line in lines]
    points = np.array([line[1:4] for line in words if line[:1] == [b"v"]], float)
    faces = [line[1:] for line in words if line[:1] == [b"f"] and len(line) > 4]
    return count_concave(points, [np.array([int(corner.partition(b"/")[0]) - 1 for corner in face]) for face in faces])


def polygons_of_ply(raw: Mapping[str, Any]) -> tuple[np.ndarray | list[np.ndarray], bool]:
    """The faces of a PLY as trimesh keeps them, and whether it has read them all with as many corners as they have."""
    data, none = raw.get("face", {}).get("data"), np.zeros((0, 3), np.int64)
    if isinstance(data, Mapping):  # of an ASCII file, [F, N] or an array of arrays
        lists = [faces for faces in data.values() if np.ndim(faces) == 2 or (len(faces) and np.ndim(faces[0]) == 1)]
        return (lists[0] if lists else none), True
    names = getattr(getattr(data, "dtype", None), "names", None) or ()
    for name in names:
        if data[name].dtype.names == ("f0", "f1"):  # how many corners a face has, and which
            corners = data[name]["f1"]
            return corners, corners.ndim == 2 and bool((data[name]["f0"] == corners.shape[1]).all())
    return none, True
