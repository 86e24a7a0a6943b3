"""Shapes to draw: the vehicle and the cells of the reduction around it."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection

from uavrl.envs.mesh import Mesh, loft
from uavrl.envs.quadrotor import ROTOR_DIRECTIONS, Airframe
from uavrl.transforms.icosahedron import TruncatedIcosahedron, truncated_icosahedron_faces
from uavrl.transforms.range_image import AZIMUTHS, ELEVATIONS, HEIGHT, RangeImage

ROTOR_RADIUS = 0.14  # m
SPHERE = 3000  # points of a sphere whose cells have no shape of their own
OUTCOMES = {"arrived": "#009E73", "collided": "#D55E00", "timed_out": "#56B4E9"}  # colours of Okabe and Ito
KINDS = {"tree": "#6b8f5e", "rock": "#8f8b84", "pole": "#a08a6a", "arch": "#9a7f72", "overhang": "#7f8794"}
OTHER_KIND = "#8a8a8a"
BODY, HEAD, PLANE, GOAL = "#0072B2", "#CC79A7", "#7b3fa0", "#f0c419"


class Part(NamedTuple):
    """A part of one colour."""

    mesh: Mesh
    colour: str


class Shell(NamedTuple):
    """The cells of a reduction as triangles and edges; ``faces`` says to which cell a triangle belongs."""

    vertices: np.ndarray
    triangles: np.ndarray
    faces: np.ndarray
    edges: np.ndarray


def vehicle(airframe: Airframe | None = None) -> list[Part]:
    """Returns the quadrotor: arms, rotors, LiDAR and a nose that shows the heading."""
    frame = airframe or Airframe()
    arms = [_bar(-direction * frame.arm, direction * frame.arm, 0.025) for direction in np.eye(3)[:2]]
    rotors = [_disc(np.append(d * frame.arm, 0.04), ROTOR_RADIUS, 0.012, 14) for d in ROTOR_DIRECTIONS]
    hub = _disc(np.array([0, 0, 0.0]), 0.1, 0.06, 12)
    lidar = _disc(np.array(frame.lidar_position), frame.lidar_diameter / 2, frame.lidar_height, 14)
    start = frame.arm + ROTOR_RADIUS
    rings = [(start, 0.06), (start + 0.01, 0.06), (start + 0.22, 0.002)]
    nose = loft(np.stack([_ring(r, 12)[:, [2, 0, 1]] + [x, 0, 0.03] for x, r in rings]))
    return [
        Part(Mesh.merge([*arms, hub, lidar]), "#22262b"),
        Part(Mesh.merge(rotors[1:]), BODY),
        Part(Mesh.merge([rotors[0], nose]), HEAD),
    ]


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
    """Returns the shell of a reduction whose cells lie in ``directions [cells, 3]``; ``radius`` in m.

    Of ours it is drawn as they are, of another one each point of the sphere belongs to the nearest direction.
    """
    for reduction, drawn in ((TruncatedIcosahedron, football), (RangeImage, belt)):
        ours = reduction.directions().numpy()
        if directions.shape == ours.shape and np.allclose(directions, ours, atol=1e-5):
            return drawn(radius)
    return patches(directions, radius)


def patches(directions: np.ndarray, radius: float) -> Shell:
    """Returns a sphere of a radius in m, each triangle of which belongs to the nearest direction."""
    height, turn = np.linspace(1 - 1 / SPHERE, 1 / SPHERE - 1, SPHERE), np.arange(SPHERE) * np.pi * (3 - 5**0.5)
    across = np.sqrt(1 - height**2)
    hull = ConvexHull(np.stack([across * np.cos(turn), across * np.sin(turn), height], -1))  # a Fibonacci lattice
    corners = hull.points[hull.simplices]
    inward = np.einsum(
        "ti,ti->t", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]
    )
    triangles = np.where((inward < 0)[:, None], hull.simplices[:, ::-1], hull.simplices)
    cells = (corners.mean(1) @ directions.T).argmax(1)
    borders = [np.delete(hull.simplices, side, 1)[cells != cells[hull.neighbors[:, side]]] for side in range(3)]
    return Shell(radius * hull.points, triangles, cells, np.unique(np.sort(np.concatenate(borders), 1), axis=0))


def belt(radius: float) -> Shell:
    """Returns the range image's cells on the sphere of a radius in m."""
    azimuth, elevation = np.meshgrid(
        (np.arange(AZIMUTHS) - 0.5) * (2 * np.pi / AZIMUTHS),
        (np.arange(ELEVATIONS + 1) - ELEVATIONS / 2) * HEIGHT,
        indexing="ij",
    )
    across = np.cos(elevation)
    vertices = radius * np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], -1)
    numbers = np.arange(azimuth.size).reshape(azimuth.shape)
    right, left = numbers, np.roll(numbers, -1, 0)
    corners = np.stack([right[:, :-1], left[:, :-1], left[:, 1:], right[:, 1:]], -1).reshape(-1, 4)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]], 1).reshape(-1, 3)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 3]], corners[:, [3, 0]]])
    edges = np.unique(np.sort(sides, 1), axis=0)
    return Shell(vertices.reshape(-1, 3), triangles, np.repeat(np.arange(len(corners)), 2), edges)


def football(radius: float) -> Shell:
    """Returns the truncated icosahedron of a circumradius in m."""
    shape = truncated_icosahedron_faces(radius)
    normals, offsets = shape.normals.double().numpy(), shape.offsets.double().numpy()
    vertices = HalfspaceIntersection(np.column_stack([normals, -offsets]), np.zeros(3)).intersections
    heights = vertices @ normals.T
    triangles, faces, edges = [], [], set()
    for face in range(len(normals)):
        corners = np.flatnonzero(heights[:, face] > heights[:, face].max() - 1e-3 * radius)
        spoke = vertices[corners] - vertices[corners].mean(0)
        side = np.cross(normals[face], spoke[0])
        around = corners[np.argsort(np.arctan2(spoke @ side, spoke @ spoke[0]))]
        triangles += [(around[0], a, b) for a, b in pairwise(around[1:])]
        faces += [face] * (len(around) - 2)
        edges |= {tuple(sorted(edge)) for edge in zip(around.tolist(), np.roll(around, -1).tolist(), strict=True)}
    return Shell(vertices, np.array(triangles), np.array(faces), np.array(sorted(edges)))
