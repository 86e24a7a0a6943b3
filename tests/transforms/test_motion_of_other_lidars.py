"""LiDARs whose rays lie otherwise than a VLP-16's see move what moves, and nothing else."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from torchrl.envs import Compose, TransformedEnv

from tests.helpers.commands import VALLEY
from tests.helpers.exported import exported
from tests.helpers.moving import BODY, straight, valley
from tests.helpers.moving import Vehicle as Flight
from uavrl import load_policy
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.sensors import SENSORS, LidarSensor
from uavrl.transforms import Guarded, MovingObjects, NavigationState
from uavrl.transforms.motion import searched_alone
from uavrl_onboard.perception.motion import MotionSight
from uavrl_onboard.perception.motion.rays import ScanPattern
from uavrl_onboard.perception.motion.sight import scales
from uavrl_onboard.policy.policy import Policy
from uavrl_onboard.vehicle import Vehicle

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
    seen = Flight().seen(lidar, [np.zeros((0, 4))] * 30, pattern=pattern_of(name))
    assert (seen[..., 6] > 0).any(1).sum() <= 1, "in one of 30 scans at most"


def test_what_moves_is(name: str, lidar: Lidar) -> None:
    way = straight((8.0, 0.5, 0.3), 3.5, math.pi, 12)
    seen = Flight().seen(lidar, way, pattern=pattern_of(name))[8:]
    errors = np.linalg.norm(seen[:, 0, :3] - np.array(way)[8:, 0, :3], axis=-1)
    assert (seen[:, 0, 6] > 0.3).all() and (errors < 1.0).all(), errors


class Level(Flight):
    """Flies level."""

    velocity = np.array([1.5, 0.4, 0.0])

    def at(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        return self.velocity * 0.1 * step, np.zeros(3)


@pytest.mark.parametrize("sensor", ["rplidar", LidarSensor("two", elevations=(0.0, 2.5), azimuth_steps=1800)])
def test_one_layer_of_beams_or_two_see_move_what_moves_and_not_what_stands(sensor: str | LidarSensor) -> None:
    lidar = Lidar(valley(), BODY, LidarConfig(max_range=4.0, far_range=12.0, sensor=sensor, range_noise=0.0))
    device = lidar.config.device
    pattern = ScanPattern(*device.field_of_view[2:], repeats=device.repeats)
    assert not Flight().seen(lidar, [np.zeros((0, 4))] * 30, pattern=pattern).any()
    way = straight((8.0, 0.5, 0.0), 3.5, math.pi, 12)
    seen = Level().seen(lidar, way, pattern=pattern)[8:]
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
        assert motion.parent_pattern == (None if sensor == "vlp16" else pattern_of(sensor))
        assert env.rollout(2, policy)["action"].isfinite().all()
        env.close()


@pytest.mark.parametrize("sensor", ["mid360", "xt32"])
def test_an_environment_of_ones_own_tells_it_too(sensor: str) -> None:
    small = {"size": (14, 12), "obstacles": 3, "min_goal_distance": 4}
    base = NavigationEnv(2, world=small, lidar={"sensor": sensor, "max_range": 10.0})
    guarded = Guarded([{"evasion": {"sight": 10.0}}, "evasion"])
    env = TransformedEnv(base, Compose(guarded, NavigationState(motion=10.0)))
    assert not env.rollout(8)["next", "moving_objects"].any() and guarded._made is not None
    about = guarded._made.vehicle
    assert ScanPattern(*about.lidar_elevations, repeats=about.lidar_repeats) == pattern_of(sensor)


@pytest.mark.parametrize("name", ["mid360", "os0_32"])
def test_on_board_a_policy_sees_move_what_it_does_in_the_simulator(name: str, lidar: Lidar, tmp_path: Path) -> None:
    """Trained with a VLP-16, it flies with another LiDAR, which it is told of."""
    folder = exported(tmp_path, "perception=range_image", "perception.motion=12", "algo.hidden=[4]")
    policy, pattern = Policy(folder), pattern_of(name)
    policy.fly_with(Vehicle(lidar_elevations=(pattern.lowest, pattern.highest), lidar_repeats=pattern.repeats))
    sight, flight = MotionSight(1, 12.0, 3, pattern=pattern), Flight()
    reported = 0
    for cloud, _, attitude in flight.scans(lidar, iter(straight((8.0, 0.5, 0.3), 3.5, math.pi, 10))):
        seen = sight.look(searched_alone(cloud, pattern), flight.velocity[None], attitude[None])
        read = policy.state(cloud[0], 3.5, 0.0, 0.0, flight.velocity, attitude)
        objects = read.reshape(3, -1)[-1, 75 : 75 + 21] * np.tile(scales(12.0), 3)
        np.testing.assert_allclose(objects, seen.ravel(), atol=1e-4)
        reported += int(seen[0, 0, 6] > 0)
    assert reported >= 3
