"""The bodies of a PyBullet world: fixed triangle meshes and vehicles, in collision groups."""

import ctypes
import sys
from collections.abc import Callable
from typing import Any

from uavrl.envs.bullet import pybullet
from uavrl.envs.mesh import Mesh
from uavrl.envs.quadrotor import Airframe

STATIC, VEHICLE, PLANE = 2, 64, 128  # collision groups: vehicles meet the other two, nothing else meets

_release = ctypes.pythonapi.Py_DecRef
_release.argtypes, _release.restype = [ctypes.py_object], None


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
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_CYLINDER,
        radius=airframe.collision_radius,
        height=airframe.collision_height,
        physicsClientId=client,
    )
    body = pybullet.createMultiBody(
        airframe.total_mass, shape, baseInertialFramePosition=airframe.centre_of_mass, physicsClientId=client
    )
    pybullet.changeDynamics(
        body,
        -1,
        localInertiaDiagonal=airframe.combined_inertia,
        linearDamping=0,
        angularDamping=0,
        activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
        physicsClientId=client,
    )
    pybullet.setCollisionFilterGroupMask(body, -1, VEHICLE, STATIC | PLANE, physicsClientId=client)
    return body
