"""Shapes to draw: the vehicle and the cells of the reduction around it."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection

from uavrl_onboard.geometry import spherical
from uavrl_onboard.mesh import Mesh, loft
from uavrl_onboard.perception.cells import (
    VLP16_GRID,
    icosahedron,
    range_image_middles,
)
from uavrl_onboard.vehicle import ARM, LIDAR_DIAMETER, LIDAR_HEIGHT, ROTOR_DIRECTIONS, VEHICLE

ROTOR_RADIUS = 0.14  # m
SPHERE = 3000  # points of a sphere whose cells have no shape of their own
BODY, HEAD = "#0072B2", "#CC79A7"  # colours of Okabe and Ito


class Shell(NamedTuple):
    """The cells of a reduction as triangles and edges; ``faces`` says to which cell a triangle belongs."""

    vertices: np.ndarray
    triangles: np.ndarray
    faces: np.ndarray
    edges: np.ndarray


def vehicle() -> list[tuple[Mesh, str]]:
    """Returns the quadrotor as parts of one colour: arms, rotors, LiDAR and a nose that shows the heading."""
    arms = [_bar(-direction * ARM, direction * ARM, 0.025) for direction in np.eye(3)[:2]]
    rotors = [_disc(np.append(d * ARM, 0.04), ROTOR_RADIUS, 0.012, 14) for d in ROTOR_DIRECTIONS]
    hub = _disc(np.array([0, 0, 0.0]), 0.1, 0.06, 12)
    lidar = _disc(np.array(VEHICLE.lidar_position), LIDAR_DIAMETER / 2, LIDAR_HEIGHT, 14)
    start = ARM + ROTOR_RADIUS
    rings = [(start, 0.06), (start + 0.01, 0.06), (start + 0.22, 0.002)]
    nose = loft(np.stack([_ring(r, 12)[:, [2, 0, 1]] + [x, 0, 0.03] for x, r in rings]))
    body, rest, head = Mesh.merge([*arms, hub, lidar]), Mesh.merge(rotors[1:]), Mesh.merge([rotors[0], nose])
    return [(body, "#22262b"), (rest, BODY), (head, HEAD)]


def _ring(radius: float, sides: int) -> np.ndarray:
    angle = np.arange(sides) * 2 * np.pi / sides
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], -1)


def _disc(centre: np.ndarray, radius: float, height: float, sides: int) -> Mesh:
    return loft(np.stack([_ring(radius, sides) + centre + [0, 0, z] for z in (-height / 2, height / 2)]))


def _bar(start: np.ndarray, end: np.ndarray, width: float) -> Mesh:
    """A square bar between two points."""
    along = end - start
    across = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    across /= np.linalg.norm(across)
    upright = np.cross(across, along) / np.linalg.norm(along)
    square = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * width / 2
    ring = square[:, :1] * across + square[:, 1:] * upright
    return loft(np.stack([ring + start, ring + end]))


def shell(directions: np.ndarray, radius: float) -> Shell:
    """Returns the cells of a reduction that lie in ``directions [cells, 3]`` on a sphere of a radius in m.

    The two reductions of this package are drawn in their own shapes; for another one, each point of the sphere belongs
    to the nearest direction.
    """
    for known, drawn in ((icosahedron(1.0).normals, football), (range_image_middles(), belt)):
        if directions.shape == known.shape and np.allclose(directions, known, atol=1e-5):
            return drawn(radius)
    height, turn = np.linspace(1 - 1 / SPHERE, 1 / SPHERE - 1, SPHERE), np.arange(SPHERE) * np.pi * (3 - 5**0.5)
    across = np.sqrt(1 - height**2)
    hull = ConvexHull(np.stack([across * np.cos(turn), across * np.sin(turn), height], -1))  # a Fibonacci lattice
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    inward = np.einsum("ti,ti->t", np.cross(b - a, c - a), a)
    triangles = np.where((inward < 0)[:, None], hull.simplices[:, ::-1], hull.simplices)
    cells = (hull.points[hull.simplices].mean(1) @ directions.T).argmax(1)
    borders = [np.delete(hull.simplices, side, 1)[cells != cells[hull.neighbors[:, side]]] for side in range(3)]
    return Shell(radius * hull.points, triangles, cells, _edges(borders))


def _edges(pairs: list[np.ndarray]) -> np.ndarray:
    """Each edge once, from pairs of corners ``[n, 2]``."""
    return np.unique(np.sort(np.concatenate(pairs), 1), axis=0)


def belt(radius: float) -> Shell:
    """Returns the range image's cells on the sphere of a radius in m."""
    grid = VLP16_GRID
    edges = np.radians([grid.elevation[0], *grid.row_borders, grid.elevation[1]])
    middles = (np.arange(grid.columns) - 0.5) * (2 * np.pi / grid.columns)
    azimuth, elevation = np.meshgrid(middles, edges, indexing="ij")
    vertices = radius * spherical(azimuth, elevation)
    right = np.arange(azimuth.size).reshape(azimuth.shape)
    left = np.roll(right, -1, 0)
    corners = np.stack([right[:, :-1], left[:, :-1], left[:, 1:], right[:, 1:]], -1).reshape(-1, 4)
    triangles = corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    edges = _edges([corners[:, [side, (side + 1) % 4]] for side in range(4)])
    return Shell(vertices.reshape(-1, 3), triangles, np.repeat(np.arange(len(corners)), 2), edges)


def football(radius: float) -> Shell:
    """Returns the truncated icosahedron of a circumradius in m."""
    normals, offsets = icosahedron(radius)
    vertices = HalfspaceIntersection(np.column_stack([normals, -offsets]), np.zeros(3)).intersections
    heights = vertices @ normals.T
    triangles, faces, edges = [], [], []
    for face in range(len(normals)):
        corners = np.flatnonzero(heights[:, face] > heights[:, face].max() - 1e-3 * radius)
        spoke = vertices[corners] - vertices[corners].mean(0)
        side = np.cross(normals[face], spoke[0])
        around = corners[np.argsort(np.arctan2(spoke @ side, spoke @ spoke[0]))]
        triangles += [(around[0], a, b) for a, b in pairwise(around[1:])]
        faces += [face] * (len(around) - 2)
        edges.append(np.stack([around, np.roll(around, -1)], -1))
    return Shell(vertices, np.array(triangles), np.array(faces), _edges(edges))
