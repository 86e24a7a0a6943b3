"""Triangle meshes: the one description of geometry that physics and LiDAR share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mesh:
    """An indexed triangle mesh in metres.

    Args:
        vertices: ``float32 [V, 3]``.
        faces: ``int32 [F, 3]``, indices into ``vertices``.

    Examples:
        >>> import numpy as np
        >>> mesh = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], dtype=np.int32))
        >>> mesh.translated((1.0, 0.0, 0.0)).vertices[0].tolist()
        [2.0, 0.0, 0.0]
    """

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

    @staticmethod
    def merge(meshes: Iterable[Mesh]) -> Mesh:
        """Returns one mesh that holds all triangles of ``meshes``."""
        vertices: list[np.ndarray] = []
        faces: list[np.ndarray] = []
        offset = 0
        for mesh in meshes:
            vertices.append(mesh.vertices)
            faces.append(mesh.faces + offset)
            offset += len(mesh.vertices)
        return Mesh(np.concatenate(vertices), np.concatenate(faces))


def halved(corners: np.ndarray) -> np.ndarray:
    """Cuts triangles ``[T, 3, 3]`` in two at the middle of their longest edges: ``[2T, 3, 3]``."""
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)  # [T, 3]: a-b, b-c, c-a
    order = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(corners, order[:, :, None], axis=1).transpose(1, 0, 2)
    middle = (a + b) / 2.0
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
