"""Boxes and rough ground for the LiDAR, and places to look from."""

from __future__ import annotations

import math

import numpy as np
import pybullet

from uavrl_onboard.mesh import Mesh

LEVEL = np.eye(3)[None]

ORIGIN = np.zeros((1, 3))


def box(centre: tuple[float, float, float], size: tuple[float, float, float]) -> Mesh:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Mesh(corners * size + centre, np.array(faces))


def terrain(rng: np.random.Generator, half: float = 12.0, cells: int = 24) -> Mesh:
    x, y = np.meshgrid(*[np.linspace(-half, half, cells)] * 2, indexing="ij")
    corner = np.arange(cells * cells).reshape(cells, cells)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(np.stack([x, y, rng.normal(0, 0.4, x.shape)], -1).reshape(-1, 3), faces)


def clutter(seed: int) -> list[Mesh]:
    rng = np.random.default_rng(seed)
    boxes = [box(rng.uniform([-9, -9, 0], [9, 9, 5]), rng.uniform(0.3, 3, 3)) for _ in range(15)]
    return [terrain(rng), *boxes]


def poses(seed: int, num: int, level: bool = False) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-0.5, 0.5, (num, 3)) * [0 if level else 1, 0 if level else 1, 2 * math.pi]
    rotations = [
        np.reshape(pybullet.getMatrixFromQuaternion(pybullet.getQuaternionFromEuler(a)), (3, 3)) for a in angles
    ]
    return rng.uniform([-8, -8, 1], [8, 8, 5], (num, 3)), np.stack(rotations)
