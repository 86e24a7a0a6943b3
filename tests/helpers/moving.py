"""Bodies that move around LiDARs, and the vehicles that carry these."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase

from tests.helpers.scenes import box, terrain
from tests.helpers.small_env import SmallEnv
from uavrl.envs.lidar import Lidar
from uavrl.transforms.motion import searched_alone
from uavrl_onboard.geometry import body_to_world
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.perception.motion import MotionSight
from uavrl_onboard.perception.motion.rays import ScanPattern

BODY = box((0.0, 0.0, 0.0), (0.8, 0.8, 0.5))


def valley() -> list[Mesh]:
    """Rough ground 2 m below, walls around, thin poles between."""
    rng = np.random.default_rng(0)
    poles = [box((x, y, 1.0), (0.1, 0.1, 9.0)) for x, y in ((4, -3), (6, 2), (9, -1), (-5, 4), (2, 7), (-7, -6))]
    walls = [box((11.5, 0, 1), (1, 24, 9)), box((0, 9, 1), (24, 1, 9)), box((0, -9.5, 1), (24, 1, 9))]
    return [terrain(rng).translated((0, 0, -2.0)), *poles, *walls]


class Vehicle:
    """Flies on and turns, rolls and pitches as it does."""

    velocity = np.array([1.5, 0.4, 0.1])

    def at(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Position and attitude."""
        return self.velocity * 0.1 * step, np.array([0.2 * math.sin(step), 0.2 * math.cos(2 * step), 0.15 * step])

    def scans(self, lidar: Lidar, bodies: Iterator[np.ndarray]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Cloud, position and attitude, one vehicle."""
        for step, body in enumerate(bodies):
            place, attitude = self.at(step)
            yield lidar.scan(place[None], body_to_world(attitude[None]), body, numbers=[step]), place, attitude

    def seen(
        self,
        lidar: Lidar,
        bodies: list[np.ndarray],
        sight: MotionSight | None = None,
        *,
        noisy: bool = False,
        wrong: tuple[float, float, float] = (0.0, 0.0, 0.0),  # degrees of roll, pitch and yaw, new at each scan
        pattern: ScanPattern | None = None,  # of another sensor than a VLP-16
    ) -> np.ndarray:
        """What is reported after each scan, in world axes from where the vehicle began, ``[T, K, 7]``."""
        sight = sight or MotionSight(1, pattern=pattern or ScanPattern())
        found, rng = [], np.random.default_rng(0)
        bias = np.radians([1.0, -1.0, 2.0]) * noisy  # of an autopilot's roll, pitch and yaw
        for cloud, place, attitude in self.scans(lidar, iter(bodies)):
            far = cloud.reshape(1, 1808, 16, 3)[:, ::5] if pattern is None else searched_alone(cloud, pattern)
            far = far.reshape(1, -1, 3)
            velocity = self.velocity + rng.normal(0, 0.1, 3) * (noisy or any(wrong))
            said = attitude + bias + (np.radians(wrong) * rng.normal(0, 1, 3) if any(wrong) else 0.0)
            objects = sight.look(far, velocity[None], said[None])[0].astype(float)
            level = body_to_world(np.array([[0.0, 0.0, said[2]]]))[0]
            turn = body_to_world(attitude[None])[0] @ body_to_world(said[None])[0].T @ level
            if not any(wrong):
                turn = body_to_world(np.array([[0.0, 0.0, attitude[2]]]))[0]
            there = objects[:, 6:] > 0
            objects[:, :3] = there * (objects[:, :3] @ turn.T + place)
            objects[:, 3:6] = objects[:, 3:6] @ turn.T
            found.append(objects)
        return np.array(found)


def straight(start: tuple[float, float, float], speed: float, heading: float, steps: int) -> list[np.ndarray]:
    """Poses ``[1, 4]`` of a body that flies level."""
    way = np.array([math.cos(heading), math.sin(heading), 0.0]) * speed * 0.1
    return [np.array([[*(np.array(start) + way * step), heading]]) for step in range(steps)]


class ScanEnv(EnvBase):
    """Three level sensors at rest in free air, past each of which a ball flies at 3 m/s, from the first step on."""

    def __init__(self) -> None:
        super().__init__(batch_size=torch.Size([3]))
        ring = torch.linspace(-0.3, 0.3, 7)
        self.ball = torch.stack(torch.broadcast_tensors(torch.tensor(6.0), ring[:, None], ring), -1).reshape(-1, 3)
        self.age = torch.zeros(3)
        shapes = {"point_cloud": self.ball.shape, "velocity": (3,), "attitude": (3,)}
        self.observation_spec = Composite({key: Unbounded((3, *shape)) for key, shape in shapes.items()}, shape=(3,))
        self.action_spec = SmallEnv().action_spec
        self.reward_spec = Unbounded((3, 1))
        self.done_spec = SmallEnv().done_spec

    def _observe(self) -> TensorDict:
        moved = torch.zeros(3, 1, 3)
        moved[:, 0, 1] = 0.3 * self.age
        ends = {key: torch.zeros(3, 1, dtype=torch.bool) for key in ("done", "terminated")}
        rest = {"velocity": torch.zeros(3, 3), "attitude": torch.zeros(3, 3)}
        return TensorDict({"point_cloud": self.ball + moved, **rest, **ends}, [3])

    def _reset(self, tensordict: TensorDict | None = None, **_: object) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        self.age = torch.where(torch.ones(3, dtype=torch.bool) if mask is None else mask.reshape(3), 0.0, self.age)
        return self._observe()

    def _step(self, tensordict: TensorDict) -> TensorDict:
        self.age = self.age + 1
        return self._observe().set("reward", torch.zeros(3, 1))

    def _set_seed(self, seed: int | None) -> None:
        pass
