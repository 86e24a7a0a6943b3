"""Triangle meshes: the one description of geometry that physics and LiDAR share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

MOST_FACES = 10_000  # of one PyBullet shape: 30,000 indices stay below its least limit, 32,768 on macOS


@dataclass(frozen=True)
class Mesh:
    """An indexed triangle mesh in metres."""

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        """Brings both arrays to the types that Embree and PyBullet take."""
        object.__setattr__(self, "vertices", np.ascontiguousarray(self.vertices, dtype=np.float32))
        object.__setattr__(self, "faces", np.ascontiguousarray(self.faces, dtype=np.int32))
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3 or self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise ValueError(
                f"A mesh takes vertices [V, 3] and faces [F, 3], got {self.vertices.shape} and {self.faces.shape}."
            )

    def translated(self, offset: Iterable[float]) -> Mesh:
        """Returns the mesh moved by ``offset`` (x, y, z)."""
        return Mesh(self.vertices + np.asarray(list(offset), dtype=np.float32), self.faces)

    def split(self, part: np.ndarray | None = None) -> list[Mesh]:
        """Returns a mesh for each number in ``part [F]``, in order; without it, parts that PyBullet takes."""
        part = np.arange(len(self.faces)) // MOST_FACES if part is None else part
        parts = []
        for number in np.unique(part):
            used, renumbered = np.unique(self.faces[part == number], return_inverse=True)
            parts.append(Mesh(self.vertices[used], renumbered.reshape(-1, 3)))
        return parts

    @staticmethod
    def merge(meshes: Iterable[Mesh]) -> Mesh:
        """Returns one mesh that holds all triangles of ``meshes``."""
        vertices, faces, offset = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.int32)], 0
        for mesh in meshes:
            vertices.append(mesh.vertices)
            faces.append(mesh.faces + offset)
            offset += len(mesh.vertices)
        return Mesh(np.concatenate(vertices), np.concatenate(faces))


def edge_lengths(corners: np.ndarray) -> np.ndarray:
    """Lengths ``[T, 3]`` of the edges ab, bc and ca of triangles ``[T, 3, 3]``."""
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)


def cut_up(corners: np.ndarray, small: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Cuts triangles ``[T, 3, 3]`` in two at the middle of their longest edges until ``small`` says yes to all."""
    found = [np.zeros((0, 3, 3))]
    while len(corners):
        done = small(corners)
        found.append(corners[done])
        corners = corners[~done]
        order = (edge_lengths(corners).argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(corners, order[:, :, None], axis=1).transpose(1, 0, 2)
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(found)
