"""Shapes to build a world from, as triangle meshes."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from uavrl_onboard.geometry import yaw_rotation
from uavrl_onboard.mesh import Mesh, loft


def edge_lengths(corners: np.ndarray) -> np.ndarray:
    """Lengths ``[T, 3]`` of the edges ab, bc and ca of triangles ``[T, 3, 3]``."""
    return lengths(np.roll(corners, -1, axis=1) - corners)


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths ``[...]`` of ``vectors [..., 3]``: ``np.linalg.norm``'s numbers, faster along so short an axis."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.sqrt(x * x + y * y + z * z)


def cut_up(corners: np.ndarray, small: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Cuts triangles ``[T, 3, 3]`` in two at the middle of their longest edges until ``small`` says yes to all."""
    found = [np.zeros((0, 3, 3))]
    while len(corners):
        done = small(corners)
        found.append(corners[done])
        corners = corners[~done]
        first, each = edge_lengths(corners).argmax(axis=1), np.arange(len(corners))
        a, b, c = (corners[each, (first + turn) % 3] for turn in range(3))
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(found)


def decimated(mesh: Mesh, most: int) -> Mesh:
    """The mesh with at most so many triangles: corners in one cell of a grid become one, ever larger cells if needed.

    Examples:
        >>> len(decimated(icosphere(4), 1000).faces) <= 1000 < len(icosphere(4).faces)
        True
    """
    cell, faces, vertices = 0.05, mesh.faces, mesh.vertices
    while len(faces) > most:
        _, first, which = np.unique(np.floor(mesh.vertices / cell), axis=0, return_index=True, return_inverse=True)
        faces = first[which.ravel()[mesh.faces]]
        a, b, c = faces.T
        faces = np.unique(faces[(a != b) & (b != c) & (c != a)], axis=0)
        cell *= 1.4
    used, renumbered = np.unique(faces, return_inverse=True)
    return Mesh(vertices[used], renumbered.reshape(-1, 3))


def tube(path: np.ndarray, radii: np.ndarray, sides: int = 8) -> Mesh:
    """Returns a closed tube along ``path [S, 2]``, x and z in the plane y = 0, with ``radii [S]``."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([tangent[:, 1], np.zeros(len(path)), -tangent[:, 0]], -1)
    angle = np.arange(sides) * 2 * np.pi / sides
    round_ = np.cos(angle)[:, None] * normal[:, None] + np.sin(angle)[:, None] * np.array([0.0, 1.0, 0.0])
    centre = np.stack([path[:, 0], np.zeros(len(path)), path[:, 1]], -1)
    return loft(centre[:, None] + np.asarray(radii)[:, None, None] * round_)


@lru_cache(maxsize=4)
def icosphere(subdivisions: int) -> Mesh:
    """Returns the unit sphere as an icosahedron whose faces are split in four ``subdivisions`` times."""
    phi = (1 + 5**0.5) / 2
    corners = np.array([(0, s, t * phi) for s in (-1, 1) for t in (-1, 1)])
    vertices = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    edge = np.isclose(apart, 2.0)
    faces = [
        (i, j, k) for i in range(12) for j in range(i) for k in range(j) if edge[i, j] and edge[j, k] and edge[i, k]
    ]
    turned = [f if np.linalg.det(vertices[list(f)]) > 0 else f[::-1] for f in faces]
    points, triangles = vertices / np.linalg.norm(vertices[0]), np.array(turned)
    for _ in range(subdivisions):
        points, triangles = _split(points, triangles)
    return Mesh(points, triangles)


def _split(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Splits every triangle of a unit sphere in four."""
    a, b, c = triangles.T
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middle = points[unique].sum(1)
    ab, bc, ca = index.reshape(3, -1) + len(points)
    split = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
    return points, np.concatenate([np.stack(corners, -1) for corners in split])


def blob(
    rng: np.random.Generator, radii: tuple[float, float, float], roughness: float = 0.2, subdivisions: int = 2
) -> Mesh:
    """Returns a bumpy ellipsoid around the origin; no bump moves its surface by more than the share ``roughness``."""
    sphere = icosphere(subdivisions)
    waves, phases = rng.normal(size=(3, 5)) * 2.0, rng.uniform(0, 2 * np.pi, 5)
    bumps = np.cos(sphere.vertices @ waves + phases).mean(1, keepdims=True)
    return Mesh(sphere.vertices * (1 + roughness * bumps) * np.asarray(radii), sphere.faces)


def turned(mesh: Mesh, yaw: float) -> Mesh:
    """Returns the mesh turned about the z axis by ``yaw`` in rad."""
    return Mesh(mesh.vertices @ yaw_rotation(-yaw), mesh.faces)
