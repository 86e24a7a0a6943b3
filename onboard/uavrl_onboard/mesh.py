"""Triangle meshes: the geometry of a simulator's world, and shapes to draw."""

from __future__ import annotations

from collections.abc import Iterable
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
        if any(array.ndim != 2 or array.shape[1] != 3 for array in (self.vertices, self.faces)):
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


def signed_volume(mesh: Mesh) -> float:
    """Returns the enclosed volume in m³: positive for a closed mesh whose faces turn outwards."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def loft(rings: np.ndarray) -> Mesh:
    """Returns the closed skin over rings ``[S, P, 3]`` that turn alike: ``2 S P`` triangles that turn outwards."""
    count, points, _ = rings.shape
    ring = np.arange(points)
    after = (ring + 1) % points
    below = (np.arange(count - 1) * points)[:, None]
    a, b, c, d = below + ring, below + after, below + after + points, below + ring + points
    sides = [np.stack(corners, -1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    middle, top = np.full(points, count * points), (count - 1) * points
    caps = [np.stack([after, ring, middle], -1), np.stack([ring + top, after + top, middle + 1], -1)]
    vertices = np.concatenate([rings.reshape(-1, 3), rings[:1].mean(1), rings[-1:].mean(1)])
    mesh = Mesh(vertices, np.concatenate(sides + caps))
    return mesh if signed_volume(mesh) > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])
