"""The valley as a user without Embree would build it: the LiDAR's rays cast by PyBullet's `rayTestBatch`.

World, physics, rays, reduction, reward and frames are those of `uavrl/Valley-v0`; only who casts the rays differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uavrl.envs.bullet import STATIC, add_fixed, pybullet, silenced
from uavrl.envs.gym import ValleyEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.mesh import Mesh

BATCH = pybullet.MAX_RAY_INTERSECTION_BATCH_SIZE - 1  # rays a call takes


class PyBulletLidar:
    """Casts what `uavrl.envs.Lidar` casts in a static world, with PyBullet.

    Args:
        meshes: the world, in a physics client of its own: rays meet whatever a client holds, the vehicles too.
        config: the range. Imperfections are left out.
        threads: of PyBullet's ray casting.
    """

    def __init__(self, meshes: Sequence[Mesh], config: LidarConfig, threads: int = 1) -> None:
        self.config, self._threads = config, threads
        with silenced():
            self._client = pybullet.connect(pybullet.DIRECT)
        for mesh in meshes:
            for part in mesh.split():
                body = add_fixed(self._client, part, STATIC)
                pybullet.setCollisionFilterGroupMask(body, -1, -1, -1, physicsClientId=self._client)
        self._directions = firing_directions()

    def scan(self, positions: np.ndarray, rotations: np.ndarray, *_: Any, **__: Any) -> np.ndarray:
        """Returns ``float32 [N, 28928, 3]``: points in the sensor frame in m, NaN for a miss."""
        clouds = [self._cast(position, rotation) for position, rotation in zip(positions, rotations, strict=True)]
        return np.stack(clouds)

    def _cast(self, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        reach = self.config.max_range
        ends = position + reach * (self._directions @ rotation.T)
        starts, stops = np.broadcast_to(position, ends.shape).tolist(), ends.tolist()
        fractions = np.fromiter(
            (
                hit[2]
                for i in range(0, len(stops), BATCH)
                for hit in pybullet.rayTestBatch(
                    starts[i : i + BATCH],
                    stops[i : i + BATCH],
                    numThreads=self._threads,
                    physicsClientId=self._client,
                )
            ),
            np.float32,
            len(stops),
        )
        return self._directions * np.where(fractions < 1.0, reach * fractions, np.nan)[:, None].astype(np.float32)


class PyBulletValleyEnv(ValleyEnv):
    """`uavrl/Valley-v0` with PyBullet's rays.

    Args:
        threads: of PyBullet's ray casting.
    """

    def __init__(self, threads: int = 1) -> None:
        super().__init__()
        base = self._env.base_env
        assert isinstance(base, NavigationEnv)
        base._lidar = PyBulletLidar(base.world.meshes, base.lidar_config, threads)  # type: ignore[assignment]
