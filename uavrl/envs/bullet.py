"""PyBullet without the lines that its C code prints, the bodies of a world, and distances between them."""

import ctypes
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from uavrl.envs.mesh import cut_up, edge_lengths
from uavrl.envs.quadrotor import Airframe
from uavrl.errors import extras
from uavrl.locks import OneAtATime
from uavrl_onboard.mesh import Mesh

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

STATIC, VEHICLE, PLANE = 2, 64, 128  # collision groups: vehicles meet the other two, nothing else meets
CLOSEST_DISTANCE_CAP = 5.0  # m
SAMPLE_SPACING = 0.5  # m, at most, between samples of the surface
SLACK = 0.02  # m: Bullet's distances are right within its collision margins

_one_at_a_time = OneAtATime()  # the output of a process belongs to all its threads
_release = ctypes.pythonapi.Py_DecRef
_release.argtypes, _release.restype = [ctypes.py_object], None


@contextmanager
def silenced() -> Iterator[None]:
    """Sends what C code prints to nowhere; Python's own output before and after is untouched."""
    if os.name != "posix":
        yield
        return
    with _one_at_a_time:
        yield from _without_output()


def _without_output() -> Iterator[None]:
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    kept = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        libc.fflush(None)
        os.dup2(kept[0], 1)
        os.dup2(kept[1], 2)
        for descriptor in (*kept, nowhere):
            os.close(descriptor)


with silenced(), extras():
    import pybullet


def connect() -> int:
    """Opens a PyBullet world without a window; gives its number."""
    with silenced():
        return int(pybullet.connect(pybullet.DIRECT))


def mesh_shape(create: Callable[..., int], mesh: Mesh, **options: Any) -> int:
    """Makes a shape of triangles by ``create``, a function of PyBullet itself; gives its id.

    PyBullet 3.2 keeps two references to each list that it reads, so that the lists of a valley, 5 MB, would never be
    freed. How many it has kept is counted, nothing else holds these lists, and as many are given back.
    """
    vertices, indices = mesh.vertices.tolist(), mesh.faces.ravel().tolist()
    lists = [vertices, indices, *vertices]
    before = list(map(sys.getrefcount, lists))
    shape = create(pybullet.GEOM_MESH, vertices=vertices, indices=indices, **options)
    kept = [after - count for after, count in zip(map(sys.getrefcount, lists), before, strict=True)]
    for each, count in zip(lists, kept, strict=True):
        for _ in range(count):
            _release(each)
    return shape


def add_fixed(client: int, mesh: Mesh, group: int) -> int:
    """Adds an exact triangle mesh to a group, which nothing moves but ourselves; gives the body's id."""
    exact = {"flags": pybullet.GEOM_FORCE_CONCAVE_TRIMESH, "physicsClientId": client}
    shape = mesh_shape(pybullet.createCollisionShape, mesh, **exact)
    body = pybullet.createMultiBody(0, shape, physicsClientId=client)
    pybullet.setCollisionFilterGroupMask(body, -1, group, VEHICLE, physicsClientId=client)
    return body


def add_vehicle(client: int, airframe: Airframe) -> int:
    """Adds a cylinder with the mass of airframe and LiDAR, its centre of mass shifted; gives the body's id.

    Bullet's own damping is off, since drag is ours, and so is sleeping.
    """
    at = {"physicsClientId": client}
    radius, height = airframe.collision_radius, airframe.collision_height
    shape = pybullet.createCollisionShape(pybullet.GEOM_CYLINDER, radius=radius, height=height, **at)
    centre, mass = airframe.centre_of_mass, airframe.total_mass
    body = pybullet.createMultiBody(mass, shape, baseInertialFramePosition=centre, **at)
    still = {"linearDamping": 0, "angularDamping": 0, "activationState": pybullet.ACTIVATION_STATE_DISABLE_SLEEPING}
    pybullet.changeDynamics(body, -1, localInertiaDiagonal=airframe.combined_inertia, **still, **at)
    pybullet.setCollisionFilterGroupMask(body, -1, VEHICLE, STATIC | PLANE, **at)
    return body


def place_body(
    client: int,
    body: int,
    centre: Sequence[float] | np.ndarray,
    attitude: Sequence[float] | np.ndarray,
    velocity: Sequence[float] | np.ndarray = (0, 0, 0),
    rates: Sequence[float] | np.ndarray = (0, 0, 0),
) -> None:
    """Puts a body's centre of mass somewhere, with an attitude (x, y, z, w), a velocity and rates in world axes."""
    pybullet.resetBasePositionAndOrientation(body, centre, attitude, physicsClientId=client)
    pybullet.resetBaseVelocity(body, velocity, rates, physicsClientId=client)


def surface_samples(mesh: Mesh, spacing: float) -> np.ndarray:
    """The middles ``[P, 3]`` of a surface's triangles, cut up until no edge is over ``spacing``."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    return cut_up(corners, lambda pieces: edge_lengths(pieces).max(axis=1) <= spacing).mean(axis=1)


class Clearance:
    """Distances from hulls to the bodies of a PyBullet world.

    Bullet looks at every triangle within the distance that it is asked for, so it is asked for no more than what the
    nearest sample of the static surface shows to be enough, and not about bodies whose boxes are farther away. The
    samples are made when they are first needed.

    Args:
        client: of PyBullet.
        meshes: the static surface.
        statics: the bodies that stay where they are.
        moving: the bodies that move.
        airframe: has the hull.
    """

    def __init__(
        self, client: int, meshes: Sequence[Mesh], statics: Sequence[int], moving: Sequence[int], airframe: Airframe
    ) -> None:
        self._client, self._meshes, self._statics, self._moving = client, list(meshes), list(statics), list(moving)
        self._ball = min(airframe.collision_radius, airframe.collision_height / 2)  # in the middle of the hull
        self._around = math.hypot(airframe.collision_radius, airframe.collision_height / 2)  # the whole hull
        boxes = [pybullet.getAABB(body, physicsClientId=client) for body in self._statics]
        self._lowest, self._highest = np.reshape(boxes, (-1, 2, 3)).swapaxes(0, 1)

    @cached_property
    def _surface(self) -> "cKDTree | None":
        from scipy.spatial import cKDTree  # here, so that it is PyBullet that is missed first

        return cKDTree(surface_samples(Mesh.merge(self._meshes), SAMPLE_SPACING)) if self._meshes else None

    def distances(self, vehicles: Sequence[int], positions: np.ndarray) -> np.ndarray:
        """Returns ``[N]``: m from each hull, around ``positions [N, 3]``, to the nearest body, at most 5."""
        distances = np.full(len(positions), CLOSEST_DISTANCE_CAP)
        if self._surface is not None:
            nearest = np.maximum(self._surface.query(positions)[0] - self._ball, 0.0)
            distances = np.minimum(nearest + SLACK, CLOSEST_DISTANCE_CAP)
        for row, (vehicle, position) in enumerate(zip(vehicles, positions, strict=True)):
            outside = np.maximum(self._lowest - position, position - self._highest).clip(min=0.0)
            near = np.linalg.norm(outside, axis=1) <= distances[row] + self._around + SLACK
            for body in [*(self._statics[each] for each in np.flatnonzero(near)), *self._moving]:
                within = float(distances[row])
                points = pybullet.getClosestPoints(vehicle, body, distance=within, physicsClientId=self._client)
                distances[row] = min([distances[row], *(point[8] for point in points)])
        return distances
