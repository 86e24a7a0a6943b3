"""LiDARs whose rays lie otherwise than a VLP-16's see move what moves, and nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from tests.helpers.commands import VALLEY
from tests.helpers.moving import BODY, Vehicle, straight, valley
from uavrl import load_policy
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.sensors import SENSORS
from uavrl.transforms import MovingObjects
from uavrl_onboard.perception.motion.rays import ScanPattern

OTHERS = ("os0_32", "os0_128", "os1_64", "xt32", "mid360")


def pattern_of(name: str) -> ScanPattern:
    sensor = SENSORS[name]
    return ScanPattern(*sensor.field_of_view[2:], repeats=sensor.repeats)


@pytest.fixture(params=OTHERS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def lidar(name: str) -> Lidar:
    return Lidar(valley(), BODY, LidarConfig(max_range=4.0, far_range=12.0, sensor=name, range_noise=0.0))


def test_what_stands_is_not_reported(name: str, lidar: Lidar) -> None:
    seen = Vehicle().seen(lidar, [np.zeros((0, 4))] * 30, pattern=pattern_of(name))
    assert (seen[..., 6] > 0).any(1).sum() <= 1, "in one of 30 scans at most"


def test_what_moves_is(name: str, lidar: Lidar) -> None:
    way = straight((8.0, 0.5, 0.3), 3.5, math.pi, 12)
    seen = Vehicle().seen(lidar, way, pattern=pattern_of(name))[8:]
    errors = np.linalg.norm(seen[:, 0, :3] - np.array(way)[8:, 0, :3], axis=-1)
    assert (seen[:, 0, 6] > 0.3).all() and (errors < 1.0).all(), errors


def test_a_pattern_that_changes_is_searched_whole_and_three_scans_must_agree() -> None:
    mid360, vlp16 = pattern_of("mid360"), pattern_of("vlp16")
    assert vlp16 == ScanPattern() and vlp16.agreeing == 1
    assert not mid360.repeats and mid360.agreeing == 3 and mid360.grid.rows == 21
    assert pattern_of("xt32").agreeing == 2


def test_an_environment_tells_its_policy_s_motion_detection_how_its_rays_lie() -> None:
    policy = load_policy("best_dynamic")
    for sensor in ("vlp16", "mid360"):
        env = policy.make_env(*VALLEY, "randomize=none", "env.world.planes=0", f"env.lidar={sensor}")
        motion = next(part for part in env.transform.modules() if isinstance(part, MovingObjects))
        assert motion.pattern == (None if sensor == "vlp16" else pattern_of(sensor))
        assert env.rollout(2, policy)["action"].isfinite().all()
        env.close()


def test_clouds_of_any_number_of_points_are_searched() -> None:
    small = {"size": (14, 12), "obstacles": 3, "min_goal_distance": 4}
    base = NavigationEnv(2, world=small, lidar={"sensor": "mid360", "max_range": 12.0})
    motion = MovingObjects()
    motion.pattern = pattern_of("mid360")
    found = TransformedEnv(base, Compose(motion)).rollout(3)["next", "moving_objects"]
    assert found.shape == (2, 3, 21) and torch.isfinite(found).all()
