"""The bodies of a PyBullet world: fixed triangle meshes and vehicles, in collision groups."""

from __future__ import annotations

import numpy as np

from uavrl.envs.bullet import pybullet
from uavrl.envs.mesh import Mesh
from uavrl.envs.quadrotor import Airframe

MESH_FACES = 10_000  # per collision shape: 30,000 indices stay below PyBullet's least limit, 32,768
STATIC, VEHICLE, PLANE = 2, 64, 128  # collision groups: vehicles meet the other two, nothing else meets


def split_mesh(mesh: Mesh, faces: int = MESH_FACES) -> list[Mesh]:
    """Cuts a mesh into parts small enough for one PyBullet shape each.

    Args:
        mesh: Any mesh.
        faces: Most faces of one part.

    Returns:
        Meshes that hold all faces of ``mesh`` together.

    Examples:
        >>> mesh = Mesh(np.eye(3), np.zeros((5, 3)))
        >>> [len(part.faces) for part in split_mesh(mesh, faces=2)]
        [2, 2, 1]
    """
    if len(mesh.faces) <= faces:
        return [mesh]
    parts = []
    for start in range(0, len(mesh.faces), faces):
        used, renumbered = np.unique(mesh.faces[start : start + faces], return_inverse=True)
        parts.append(Mesh(mesh.vertices[used], renumbered.reshape(-1, 3)))
    return parts


def add_fixed(client: int, mesh: Mesh, group: int) -> int:
    """Adds an exact triangle mesh that nothing moves but ourselves.

    Args:
        client: PyBullet's physics client.
        mesh: At most :data:`MESH_FACES` faces or so, see :func:`split_mesh`.
        group: :data:`STATIC` or :data:`PLANE`.

    Returns:
        The body's id.

    Examples:
        >>> client = pybullet.connect(pybullet.DIRECT)
        >>> add_fixed(client, Mesh(np.eye(3), np.array([[0, 1, 2]])), STATIC)
        0
        >>> pybullet.disconnect(client)
    """
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_MESH,
        vertices=mesh.vertices.tolist(),
        indices=mesh.faces.ravel().tolist(),
        flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        physicsClientId=client,
    )
    body = pybullet.createMultiBody(0, shape, physicsClientId=client)
    pybullet.setCollisionFilterGroupMask(body, -1, group, VEHICLE, physicsClientId=client)
    return body


def add_vehicle(client: int, airframe: Airframe) -> int:
    """Adds a cylinder with the mass of airframe and LiDAR, its centre of mass shifted.

    Bullet's own damping is off, since drag is ours, and so is sleeping.

    Args:
        client: PyBullet's physics client.
        airframe: Gives hull, mass and inertia.

    Returns:
        The body's id.

    Examples:
        >>> client = pybullet.connect(pybullet.DIRECT)
        >>> round(pybullet.getDynamicsInfo(add_vehicle(client, Airframe()), -1, client)[0], 3)
        2.307
        >>> pybullet.disconnect(client)
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
