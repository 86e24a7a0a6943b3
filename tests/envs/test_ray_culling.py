"""Culled scans against scans that cast every ray."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.scenes import LEVEL, ORIGIN, box, clutter, poses
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl_onboard.mesh import Mesh


def with_and_without(meshes: list[Mesh], max_range: float, positions: np.ndarray, rotations: np.ndarray):
    culled = Lidar(meshes, None, LidarConfig(max_range=max_range))
    whole = Lidar(meshes, None, LidarConfig(max_range=max_range))
    assert culled._culler is not None
    whole._culler = None
    return culled.scan(positions, rotations), whole.scan(positions, rotations)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 4.0, 9.9]))
def test_culling_changes_no_point(seed: int, max_range: float) -> None:
    culled, whole = with_and_without(clutter(seed), max_range, *poses(seed + 1, 3))
    np.testing.assert_array_equal(culled, whole)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (3.0, 19.9, 0.0), (0.0, -20.0, 0.0), (900.0, -1500.0, 0.0)])
def test_culling_in_float32_holds_far_from_the_origin(offset: tuple[float, float, float]) -> None:
    meshes = [mesh.translated(offset) for mesh in clutter(5)]
    positions, rotations = poses(6, 6)
    culled, whole = with_and_without(meshes, 4.0, positions + offset, rotations)
    np.testing.assert_array_equal(culled, whole)
    assert np.isfinite(whole).any()


def test_what_the_sensor_touches_straight_behind_it_is_seen_by_every_vehicle() -> None:
    """A sphere around the sensor's z axis spans a whole turn, which may begin a step before the first ray."""
    behind = np.array([[[-0.03, 0.0, -0.05], [-0.03, -0.05, 0.05], [-0.03, 0.05, 0.05]]])
    speck = Mesh(behind.reshape(-1, 3), np.arange(3).reshape(1, 3))
    for num in (1, 3):
        culled, whole = with_and_without([speck], 4.0, np.repeat(ORIGIN, num, 0), np.repeat(LEVEL, num, 0))
        np.testing.assert_array_equal(culled, whole)
        assert np.isfinite(whole).any(axis=(1, 2)).all()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_single_small_triangles_all_around_are_never_lost(seed: int) -> None:
    """Slivers and dust, near and far, also around the seam of the scan straight ahead."""
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=(40, 3)) * [1.5, 0.3 if seed % 2 else 1.5, 0.3]
    corners = middle[:, None] + rng.normal(size=(40, 3, 3)) * rng.choice([0.003, 0.03, 0.5], (40, 1, 1))
    dust = Mesh(corners.reshape(-1, 3), np.arange(120).reshape(40, 3))
    culled, whole = with_and_without([dust], 4.0, ORIGIN, LEVEL)
    np.testing.assert_array_equal(culled, whole)
    assert not np.isnan(whole).all()


def test_nothing_is_lost_where_the_borders_of_two_bands_lie_opposite() -> None:
    """The last sphere of a band and the first one of the next lie as far apart as any two."""
    meshes = [box((x, y, 0.0), (0.2, 0.2, 0.2)) for x in (-10.0, 10.0) for y in (30.0, 10.0, -10.0)]
    culled, whole = (Lidar(meshes, None, {"max_range": 4.0}) for _ in range(2))
    whole._culler = None
    places = np.array([[x * 0.8, y, 0.0] for x in (-10.0, 10.0) for y in (30.0, 10.0, -10.0)])
    rotations = np.broadcast_to(np.eye(3), (len(places), 3, 3))
    found = culled.scan(places, rotations)
    np.testing.assert_array_equal(found, whole.scan(places, rotations))
    assert (~np.isnan(found[..., 0])).any(1).all()


@pytest.mark.parametrize("cycle", [0, 7, 8, 900, 904, 1791, 1792, 1799, 1800, 1807])
def test_dust_on_the_rays_next_to_bin_borders_is_hit(cycle: int) -> None:
    directions = Lidar([]).directions.reshape(1808, 16, 3)[cycle]
    specks = directions[[0, 1, 14, 15]].reshape(-1, 1, 3) * 3.0
    across = np.cross(specks, [0.0, 0.0, 1.0])
    corners = specks + 1e-5 * np.concatenate(
        [across, [[[0, 0, 3.0]]] - across / 2, [[[0, 0, -3.0]]] - across / 2], axis=1
    )
    dust = Mesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))
    culled, whole = with_and_without([dust], 4.0, ORIGIN, LEVEL)
    np.testing.assert_array_equal(culled, whole)
    assert (~np.isnan(whole[0, :, 0])).sum() == 4


def test_most_rays_of_a_sparse_scene_are_culled() -> None:
    pole = box((0.0, 3.0, 0.0), (0.2, 0.2, 6.0))
    culler = Lidar([pole], None, LidarConfig(max_range=4.0))._culler
    assert culler is not None
    grid = culler.candidates(ORIGIN, LEVEL, [0]).reshape(1, 1808, 16)
    assert 0.01 < grid.mean() < 0.1
    left = 1808 * 3 // 4  # the sensor turns clockwise: it looks left after three quarters of the turn
    assert grid[0, left - 5 : left + 5].all()
    assert not culler.candidates(np.array([[50.0, 0, 0]]), LEVEL, [0]).any()
    assert culler.candidates(np.zeros((0, 3)), np.zeros((0, 3, 3)), []).shape == (0, 28928)
