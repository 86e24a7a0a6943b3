"""Voxels of a point cloud, and the faces between solid and free ones."""

import numpy as np

# The six sides of a voxel: the axis across the face, and the direction along it that leads out.
_SIDES = [(axis, sign) for axis in range(3) for sign in (1, -1)]


def occupied(points: np.ndarray, voxel: float, least: int) -> np.ndarray:
    """The voxels ``int [V, 3]`` that hold at least so many of the points ``[P, 3]``.

    Examples:
        >>> occupied(np.array([[0.1, 0.1, 0.1], [0.2, 0.1, 0.1], [-0.1, 0.0, 0.0]]), 0.5, 2).tolist()
        [[0, 0, 0]]
    """
    cells = np.floor(points / voxel).astype(np.int64)
    low = cells.min(0)
    shape = cells.max(0) - low + 1
    keys, counts = np.unique(np.ravel_multi_index(tuple((cells - low).T), tuple(shape)), return_counts=True)
    return np.stack(np.unravel_index(keys[counts >= least], tuple(shape)), -1) + low


def voxel_mesh(solid: np.ndarray, voxel: float) -> np.ndarray:
    """Corners ``[F, 3, 3]`` in m of triangles around voxels ``[V, 3]``; faces in one plane are joined to rectangles.

    Examples:
        >>> voxel_mesh(np.array([[0, 0, 0], [1, 0, 0]]), 0.5).shape  # a box of two voxels: six rectangles
        (12, 3, 3)
    """
    low = solid.min(0) - 1
    shape = tuple(solid.max(0) - low + 2)
    keys = np.sort(np.ravel_multi_index(tuple((solid - low).T), shape))
    found = [np.zeros((0, 3, 3))]
    for axis, sign in _SIDES:
        beside = solid - low
        beside[:, axis] += sign
        neighbour = np.ravel_multi_index(tuple(beside.T), shape)
        open_ = solid[keys[np.searchsorted(keys, neighbour).clip(max=len(keys) - 1)] != neighbour]
        u, v = (axis + 1) % 3, (axis + 2) % 3
        plane, u0, u1, v0, v1 = _rectangles(open_[:, axis], open_[:, u], open_[:, v])
        corner = np.empty((4, len(plane), 3))
        corner[..., axis] = plane + (sign > 0)
        corner[:, :, u], corner[:, :, v] = np.stack([u0, u1, u1, u0]), np.stack([v0, v0, v1, v1])
        a, b, c, d = corner * voxel
        two = (a, b, c), (a, c, d)
        found += [np.stack(each if sign > 0 else each[::-1], axis=1) for each in two]
    return np.concatenate(found)


def _rectangles(plane: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
    """Joins unit squares at ``u, v [N]`` of planes: the plane, and first and last edge along u and v of each."""
    order = np.lexsort((v, u, plane))
    plane, u, v = plane[order], u[order], v[order]
    new = np.ones(len(plane), bool)
    new[1:] = (plane[1:] != plane[:-1]) | (u[1:] != u[:-1]) | (v[1:] != v[:-1] + 1)
    first = np.flatnonzero(new)
    v0, v1 = v[first], v[np.append(first[1:], len(v)) - 1] + 1 if len(v) else v
    plane, u = plane[first], u[first]
    order = np.lexsort((u, v1, v0, plane))
    plane, u, v0, v1 = plane[order], u[order], v0[order], v1[order]
    new = np.ones(len(plane), bool)
    new[1:] = (plane[1:] != plane[:-1]) | (v0[1:] != v0[:-1]) | (v1[1:] != v1[:-1]) | (u[1:] != u[:-1] + 1)
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(u)) - 1 if len(u) else first
    return plane[first], u[first], u[last] + 1, v0[first], v1[first]
