"""Of a scan in any order those points count that the simulator's far rays would have met."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.moving import BODY, Vehicle, straight, valley
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl_onboard.geometry import body_to_world
from uavrl_onboard.lidar.packets import decode_vlp16, encode_scan
from uavrl_onboard.perception.motion import MotionSight
from uavrl_onboard.perception.motion.rays import far_rays

WAY = straight((8.0, 0.5, 0.3), 3.5, 2.3, 8)


@pytest.fixture(scope="module")
def real() -> Lidar:
    """A sensor all of whose rays reach far."""
    return Lidar(valley(), BODY, LidarConfig(max_range=100.0))


def scans(lidar: Lidar, turned: float = 0.0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Clouds and attitudes of a vehicle in whose sight a body flies; the sensor begins ``turned`` rad to the left."""
    vehicle, found = Vehicle(), []
    for step, body in enumerate(WAY):
        place, attitude = vehicle.at(step)
        rotation, to_sensor = (body_to_world(np.array([each])) for each in (attitude, (0.0, 0.0, turned)))
        cloud = lidar.scan(place[None], rotation @ to_sensor, body)[0]
        found.append(((cloud @ to_sensor[0].T).astype(np.float32), attitude))
    return found


def objects(clouds: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """What is reported after each scan, ``[T, K, 7]``."""
    sight, velocity = MotionSight(1), Vehicle.velocity[None]
    return np.array([sight.look(cloud[None], velocity, attitude[None])[0] for cloud, attitude in clouds])


@pytest.fixture(scope="module")
def expected(real: Lidar) -> np.ndarray:
    """By every fifth firing cycle, as the transform takes them."""
    seen = objects([(cloud.reshape(1808, 16, 3)[::5].reshape(-1, 3), attitude) for cloud, attitude in scans(real)])
    assert (seen[4:, 0, 6] > 0.3).all(), "a body is seen"
    return seen


def test_in_any_order_they_show_the_same_objects(real: Lidar, expected: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    shuffled = [
        (far_rays(rng.permutation(cloud[np.isfinite(cloud).all(1)])), attitude) for cloud, attitude in scans(real)
    ]
    np.testing.assert_array_equal(objects(shuffled), expected)


def test_in_the_simulator_the_rays_that_are_cut_do_not_count() -> None:
    cut = Lidar(valley(), BODY, LidarConfig(max_range=4.0, far_range=12.0))
    for cloud, _ in scans(cut)[:2]:
        far = cloud.reshape(1808, 16, 3)[::5].reshape(-1, 3)
        np.testing.assert_array_equal(far_rays(cloud[::-1]), far[np.isfinite(far).all(1)])


def test_of_packets_they_show_nearly_the_same(real: Lidar, expected: np.ndarray) -> None:
    clouds = [(far_rays(decode_vlp16(encode_scan(cloud))), attitude) for cloud, attitude in scans(real)]
    seen = objects(clouds)
    np.testing.assert_allclose(seen[5:, 0, :3], expected[5:, 0, :3], atol=0.1)
    np.testing.assert_allclose(seen[5:, 0, 3:6], expected[5:, 0, 3:6], atol=0.3)
    assert not seen[5:, 1:].any()


@pytest.mark.parametrize("turned", [0.1, 0.37, 0.6])  # degrees
def test_a_sensor_that_begins_elsewhere_shows_nearly_the_same(real: Lidar, expected: np.ndarray, turned: float) -> None:
    seen = objects([(far_rays(cloud), attitude) for cloud, attitude in scans(real, np.radians(turned))])
    np.testing.assert_allclose(seen[5:, 0, :3], expected[5:, 0, :3], atol=0.25)
    np.testing.assert_allclose(seen[5:, 0, 3:6], expected[5:, 0, 3:6], atol=0.5)
    assert not seen[5:, 1:].any()


@pytest.mark.parametrize(("kept", "of"), [(1, 2), (5, 6)])
def test_a_sensor_that_turns_faster_shows_nearly_the_same(
    real: Lidar, expected: np.ndarray, kept: int, of: int
) -> None:
    """Twenty times a second, and twelve."""
    some = np.arange(1808) % of < kept
    seen = objects([(far_rays(cloud.reshape(1808, 16, 3)[some].reshape(-1, 3)), each) for cloud, each in scans(real)])
    np.testing.assert_allclose(seen[5:, 0, :3], expected[5:, 0, :3], atol=0.25)
    np.testing.assert_allclose(seen[5:, 0, 3:6], expected[5:, 0, 3:6], atol=0.5)
    assert not seen[5:, 1:].any()


def test_misses_count_nowhere_and_ahead_is_the_first() -> None:
    points = np.array([[np.nan] * 3, [np.inf, 0, 0], [0, 0, 0], [3.0, -0.001, 0], [3.0, 0, 0], [3e38, 0, 3e38]])
    assert far_rays(points.astype(np.float32)).tolist() == [[3, 0, 0], [3.0, pytest.approx(-0.001), 0]]
    assert far_rays(np.zeros((0, 3))).shape == (0, 3)
