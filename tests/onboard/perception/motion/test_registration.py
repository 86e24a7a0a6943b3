from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.scenes import box, terrain
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.world import World, WorldConfig
from uavrl_onboard.geometry import body_to_world
from uavrl_onboard.perception.motion.occlusion import Grid, find_returns, range_images
from uavrl_onboard.perception.motion.registration import (
    LEAST_COMPARED,
    Alignment,
    orthonormal,
    point_images,
    register,
    rotation_by,
    sample,
)

FAR = LidarConfig(max_range=4.0, far_range=12.0)
BODY = box((0.0, 0.0, 0.0), (0.8, 0.8, 0.5))
TURN, MOVE = np.radians([1.5, -1.0, 3.0]), np.array([0.15, 0.04, 0.01])  # between the two scans


@pytest.fixture(scope="module")
def lidar() -> Lidar:
    poles = [box((x, y, 1.0), (0.3, 0.3, 9.0)) for x, y in ((4, -3), (6, 2), (-5, 4), (2, 7), (-7, -6))]
    walls = [box((11.0, 0, 1), (1, 24, 9)), box((0, 9, 1), (24, 1, 9)), box((0, -9.5, 1), (24, 1, 9))]
    return Lidar([terrain(np.random.default_rng(0)).translated((0, 0, -2.0)), *poles, *walls], BODY, FAR)


def images(cloud: np.ndarray) -> np.ndarray:
    far = cloud.reshape(1, 1808, 16, 3)[:, ::5].reshape(1, -1, 3)
    return point_images(find_returns(far, 12.0), 1, Grid())


def laid_over(lidar: Lidar, place: np.ndarray, bodies: list[np.ndarray | None]) -> Alignment:
    """Two scans ``TURN`` and ``MOVE`` apart, of which the attitude says that the sensor did not turn."""
    at, turns = np.stack([place, place + MOVE]), body_to_world(np.stack([np.zeros(3), TURN]))
    first, second = (images(lidar.scan(at[step, None], turns[step, None], body)) for step, body in enumerate(bodies))
    return register(sample(second), first, Grid(), np.eye(3)[None], MOVE[None])


def error(found: Alignment) -> float:
    """Of the rotation, in degrees."""
    return float(np.degrees(np.arccos(min((np.trace(found.rotations[0].T @ body_to_world(TURN[None])[0]) - 1) / 2, 1))))


def test_a_small_rotation_is_recovered(lidar: Lidar) -> None:
    found = laid_over(lidar, np.zeros(3), [None, None])
    assert found.fits[0] and error(found) < 0.4
    assert np.allclose(found.places[0], MOVE, atol=0.03)


def test_a_moving_body_does_not_disturb_it(lidar: Lidar) -> None:
    bodies = [np.array([[5.0, 0.5 + 0.4 * step, 0.2, 0.0]]) for step in range(2)]
    found = laid_over(lidar, np.zeros(3), bodies)
    assert found.fits[0] and error(found) < 0.4


def test_it_is_recovered_in_a_valley() -> None:
    world = World(WorldConfig(seeds=[200]))
    start = world.sample_task(np.random.default_rng(0)).start
    found = laid_over(Lidar(world.meshes, BODY, FAR), start, [None, None])
    assert found.fits[0] and error(found) < 0.5


def test_too_few_returns_say_so() -> None:
    few = np.full((1, 28928, 3), np.nan, np.float32)
    few[0, :400:80] = [5.0, 0.0, 0.0]
    found = register(sample(images(few)), images(few), Grid(), np.eye(3)[None], np.zeros((1, 3)))
    assert found.compared[0] < LEAST_COMPARED
    assert np.allclose(found.rotations[0], np.eye(3))


def test_rotations_about_vectors_and_without_rounding() -> None:
    yaw = rotation_by(np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.0]]))
    assert np.allclose(yaw, body_to_world(np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.0]])))
    mended = orthonormal(yaw * (1 + 1e-4))
    assert np.allclose(mended @ mended.transpose(0, 2, 1), np.eye(3), atol=1e-7)


def test_images_hold_the_least_range_where_returns_share_a_cell() -> None:
    rng, grid = np.random.default_rng(0), Grid(rows=4, columns=9)
    seen = find_returns((rng.normal(size=(2, 500, 3)) * [3.0, 3.0, 0.3]).astype(np.float32), 12.0)
    expected = np.full(2 * 4 * 9, np.inf, np.float32)
    inside, at = seen.in_cells(grid)
    np.minimum.at(expected, at, seen.ranges[inside])
    np.testing.assert_array_equal(range_images(seen, 2, grid).ravel(), expected)
