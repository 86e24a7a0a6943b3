"""The planes in a PyBullet world, of which only those near a vehicle are moved."""

import numpy as np

from uavrl.envs.bullet import CLOSEST_DISTANCE_CAP, PLANE, add_fixed, pybullet
from uavrl_onboard.mesh import Mesh

ASIDE = -1e4  # m, the height of planes that no vehicle is near; they stand apart, so that they are no pairs to Bullet
ROOM = 2.0  # m, more than a vehicle flies in a control period, and its hull


class PlaneBodies:
    """K planes that fly where they are told. Bullet costs time for each body that is moved, so those far away are not.

    Far is what no vehicle can touch within a control period, or measure its clearance to.

    Args:
        client: of PyBullet.
        mesh: their shape, x forward; None where there are none.
        count: K.

    Attributes:
        poses: ``[K, 4]``, where they are: x, y, z in m and yaw in rad.
    """

    def __init__(self, client: int, mesh: Mesh | None, count: int) -> None:
        self._client = client
        self.bodies = [] if mesh is None else [add_fixed(client, mesh, PLANE) for _ in range(count)]
        size = 0.0 if mesh is None else float(np.linalg.norm(mesh.vertices, axis=1).max())
        self._reach = CLOSEST_DISTANCE_CAP + size + ROOM
        self.poses = np.zeros((len(self.bodies), 4))
        self._near = np.zeros(len(self.bodies), dtype=bool)
        for plane in range(len(self.bodies)):
            self._put_aside(plane)

    def place(self, poses: np.ndarray, vehicles: np.ndarray) -> None:
        """Puts the planes at ``poses [K, 4]``: x, y, z in m and yaw in rad, with vehicles at ``[N, 3]``."""
        self.poses = poses
        self._choose(poses[None], vehicles)
        self.move(0)

    def bring(self, vehicles: np.ndarray) -> None:
        """Lets those be where they are that are near to vehicles that have come to ``[N, 3]``."""
        if self.bodies:
            self.place(self.poses, vehicles)

    def begin(self, path: np.ndarray, vehicles: np.ndarray) -> None:
        """Takes in the way of a control period: ``[T, K, 4]``, of which :meth:`move` then flies each step."""
        self._choose(path, vehicles)
        self.poses = path[-1]

    def move(self, step: int) -> None:
        """Moves the planes that are near to where they are at a step of the way."""
        for plane, (x, y, z, sin, cos) in zip(self._moved, self._path[step], strict=True):
            place, turn = (x, y, z), (0.0, 0.0, sin, cos)
            pybullet.resetBasePositionAndOrientation(self.bodies[plane], place, turn, physicsClientId=self._client)

    def _choose(self, path: np.ndarray, vehicles: np.ndarray) -> None:
        """Finds the planes that are near anywhere on their ways ``[T, K, 4]``, and puts the others aside."""
        flown = np.linalg.norm(np.diff(path[..., :3], axis=0), axis=-1).max(0, initial=0.0) * len(path)  # [K]
        ends = path[[0, -1], :, None, :3] - vehicles  # a plane may enter anew between them
        near = (np.linalg.norm(ends, axis=-1) < self._reach + flown[:, None]).any((0, 2))
        for plane in np.flatnonzero(self._near & ~near).tolist():
            self._put_aside(plane)
        self._near, self._moved = near, np.flatnonzero(near).tolist()
        chosen = path[:, near]
        half = chosen[..., 3:] / 2
        self._path = np.concatenate([chosen[..., :3], np.sin(half), np.cos(half)], axis=-1).tolist()

    def _put_aside(self, plane: int) -> None:
        away = (10.0 * plane, 0.0, ASIDE)
        pybullet.resetBasePositionAndOrientation(self.bodies[plane], away, (0, 0, 0, 1), physicsClientId=self._client)
