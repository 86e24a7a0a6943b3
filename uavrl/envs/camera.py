"""Pictures of the world from behind a vehicle, drawn by PyBullet."""

import weakref
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from uavrl.envs.bullet import connect, mesh_shape, pybullet
from uavrl.envs.navigation import NavigationEnv
from uavrl_onboard.geometry import heading_vector
from uavrl_onboard.mesh import Mesh

WIDTH, HEIGHT = 480, 360  # pixels
BEHIND, ABOVE, AHEAD = 3.0, 1.2, 2.0  # m from the UAV: the camera's place, and the point that it looks at
TERRAIN, OBSTACLE, PLANE, GOAL, UAV = (0.45, 0.5, 0.35), (0.6, 0.5, 0.42), (0.8, 0.2, 0.15), (1, 1, 1), (0.1, 0.3, 0.8)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


class Camera:
    """A camera that follows a vehicle of an environment, which has been reset, from behind.

    It draws in a PyBullet world of its own, in which nothing moves by itself: the physics does not notice it. A picture
    shows one vehicle, since vehicles neither see nor touch each other.
    """

    def __init__(self, env: NavigationEnv) -> None:
        client = connect()
        self.close = weakref.finalize(self, pybullet.disconnect, physicsClientId=client)
        self._env = env
        self._at: dict[str, Any] = {"physicsClientId": client}
        config, airframe = env.world.config, env.airframe
        for place in env.world.places:
            obstacles = Mesh.merge(obstacle.mesh for obstacle in place.obstacles).split()
            ground = [] if place.ground is None else place.ground.tiles()
            for parts, colour in ((ground, TERRAIN), (obstacles, OBSTACLE)):
                for part in parts:
                    self._mesh(part.translated((*place.origin, 0.0)), colour)
        self._planes = [self._mesh(env.plane_mesh, PLANE) for _ in env.plane_poses()]
        self._goal = self._cylinder(config.goal_radius, config.ceiling, GOAL)
        self._uav = self._cylinder(airframe.collision_radius, airframe.collision_height, UAV)

    def __reduce__(self) -> tuple[type["Camera"], tuple[NavigationEnv]]:
        """Return what makes another one for a copy of the environment: a PyBullet world cannot be shared."""
        return type(self), (self._env,)

    def _mesh(self, mesh: Mesh, colour: tuple[float, ...]) -> int:
        shape = mesh_shape(pybullet.createVisualShape, mesh, rgbaColor=(*colour, 1.0), **self._at)
        return pybullet.createMultiBody(0, -1, shape, **self._at)

    def _cylinder(self, radius: float, length: float, colour: tuple[float, ...]) -> int:
        size = {"radius": radius, "length": length, "rgbaColor": (*colour, 1.0)}
        shape = pybullet.createVisualShape(pybullet.GEOM_CYLINDER, **size, **self._at)
        return pybullet.createMultiBody(0, -1, shape, **self._at)

    def picture(self, goal: np.ndarray, vehicle: int = 0) -> np.ndarray:
        """Return the picture from behind a vehicle now, with its goal at ``goal [3]`` in m: ``uint8 [360, 480, 3]``."""
        simulation = self._env.simulation
        position, yaw = simulation.position[vehicle], float(simulation.yaw[vehicle])
        self._put(self._goal, goal)
        self._put(self._uav, position, Rotation.from_matrix(simulation.rotation[vehicle]).as_quat())
        for body, pose in zip(self._planes, self._env.plane_poses(), strict=True):
            self._put(body, pose[:3], Rotation.from_euler("z", pose[3]).as_quat())
        ahead = np.append(heading_vector(yaw), 0.0)
        eye = position - BEHIND * ahead + [0.0, 0.0, ABOVE]
        view = pybullet.computeViewMatrix(eye.tolist(), (position + AHEAD * ahead).tolist(), (0, 0, 1))
        lens = pybullet.computeProjectionMatrixFOV(60.0, WIDTH / HEIGHT, 0.1, 100.0)
        drawer = {"shadow": 0, "renderer": pybullet.ER_TINY_RENDERER}
        drawn = pybullet.getCameraImage(WIDTH, HEIGHT, view, lens, **drawer, **self._at)
        return np.reshape(drawn[2], (HEIGHT, WIDTH, 4))[..., :3].astype(np.uint8)

    def _put(self, body: int, position: np.ndarray, attitude: np.ndarray = LEVEL) -> None:
        pybullet.resetBasePositionAndOrientation(body, position.tolist(), attitude.tolist(), **self._at)
