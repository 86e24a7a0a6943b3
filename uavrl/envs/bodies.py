"""The bodies of a PyBullet world: fixed triangle meshes and vehicles, in collision groups."""

from uavrl.envs.bullet import pybullet
from uavrl.envs.mesh import Mesh
from uavrl.envs.quadrotor import Airframe

STATIC, VEHICLE, PLANE = 2, 64, 128  # collision groups: vehicles meet the other two, nothing else meets


def add_fixed(client: int, mesh: Mesh, group: int) -> int:
    """Adds an exact triangle mesh to a group, which nothing moves but ourselves; gives the body's id."""
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
