"""Independent measures of geometry, by Embree, Bullet and plain vector algebra."""

from __future__ import annotations

import numpy as np
import pybullet as p
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from pybullet_utils.bullet_client import BulletClient

from uavrl_onboard.mesh import Mesh, signed_volume

LIDAR_RANGE = 100.0  # m


def embree(meshes) -> EmbreeScene:
    scene = EmbreeScene()
    for mesh in meshes:
        TriangleMesh(scene, mesh.vertices, mesh.faces)
    return scene


def cast(scene, origins, directions, length=LIDAR_RANGE) -> np.ndarray:
    distances = np.full(len(origins), length, dtype=np.float32)
    found = scene.run(
        np.ascontiguousarray(origins, np.float32),
        np.ascontiguousarray(directions, np.float32),
        distances,
        query="DISTANCE",
    )
    return np.asarray(found if found is not None else distances)


def point_triangle_distance(point: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Exact least distance of a point to triangles [F, 3]: to their planes where it projects inside, else to edges."""
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = ((point - a) * normal).sum(1)
    foot = point - height[:, None] * normal
    inside = np.ones(len(a), dtype=bool)
    best = np.inf
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(end - start, foot - start) * normal).sum(1) >= 0
        edge = end - start
        share = (((point - start) * edge).sum(1) / (edge * edge).sum(1)).clip(0, 1)
        best = min(best, np.linalg.norm(point - start - share[:, None] * edge, axis=1).min())
    return min(best, np.abs(height[inside]).min(initial=np.inf))


def parts(mesh: Mesh):
    """Splits a mesh into its connected parts."""
    owner = np.arange(len(mesh.vertices))
    while True:
        lowest = owner[mesh.faces].min(1)
        before = owner.copy()
        for corner in range(3):
            np.minimum.at(owner, mesh.faces[:, corner], lowest)
        if (before == owner).all():
            break
    label = owner[mesh.faces[:, 0]]
    return [Mesh(mesh.vertices, mesh.faces[label == one]) for one in np.unique(label)]


def assert_closed(mesh: Mesh) -> None:
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert set(map(tuple, edges.tolist())) == {(b, a) for a, b in edges.tolist()}
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-5
    for part in parts(mesh):
        assert signed_volume(part) > 0


def bullet_world(meshes: list[Mesh]) -> tuple[BulletClient, list[int]]:
    """Returns a Bullet world of exact, fixed meshes, and their bodies."""
    client, bodies = BulletClient(p.DIRECT), []
    for mesh in meshes:
        shape = client.createCollisionShape(
            p.GEOM_MESH,
            vertices=mesh.vertices.tolist(),
            indices=mesh.faces.ravel().tolist(),
            flags=p.GEOM_FORCE_CONCAVE_TRIMESH,
        )
        assert shape >= 0
        bodies.append(client.createMultiBody(0, shape))
    return client, bodies


def convex_body(client: BulletClient, mesh: Mesh) -> int:
    """Adds the convex hull of a mesh."""
    return client.createMultiBody(0, client.createCollisionShape(p.GEOM_MESH, vertices=mesh.vertices.tolist()))


def edges_of(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts ``[E, 3]``, directions ``[E, 3]`` and lengths ``[E]`` of the edges of all triangles."""
    corners = mesh.vertices[mesh.faces].astype(float)
    starts = corners.reshape(-1, 3)
    ahead = (np.roll(corners, -1, axis=1) - corners).reshape(-1, 3)
    length = np.linalg.norm(ahead, axis=1)
    return starts, ahead / length[:, None], length


def pierced(one: Mesh, other: Mesh, scene: EmbreeScene) -> bool:
    """Whether two surfaces meet: an edge of one passes through a triangle of the other, whose scene is given."""
    starts, ahead, length = edges_of(one)
    if (cast(scene, starts, ahead) < length).any():
        return True
    low, high = one.vertices.min(0) - 0.01, one.vertices.max(0) + 0.01
    corners = other.vertices[other.faces]
    near = ((corners.min(1) <= high) & (corners.max(1) >= low)).all(1)
    if not near.any():
        return False
    starts, ahead, length = edges_of(Mesh(other.vertices, other.faces[near]))
    return bool((cast(embree([one]), starts, ahead) < length).any())
