"""Points of a LiDAR that is not mounted upright and forward."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uavrl_onboard.lidar.mount import UPRIGHT, mount_rotation, mount_tilt, mount_trouble, turned

MOUNTS = [(180.0, 0.0, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, 90.0), (-30.0, 50.0, 170.0)]


@pytest.mark.parametrize("mount", MOUNTS)
def test_it_turns_as_a_joint_of_a_urdf_does(mount: tuple[float, ...]) -> None:
    fixed_axes = Rotation.from_euler("xyz", mount, degrees=True)
    np.testing.assert_allclose(mount_rotation(mount), fixed_axes.as_matrix(), atol=1e-12)
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    found = turned(points, mount_rotation(mount))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, fixed_axes.apply(points), atol=1e-5)
    assert mount_tilt(mount) == pytest.approx(np.degrees(np.arccos(abs(fixed_axes.apply([0, 0, 1])[2]))), abs=1e-5)


def test_where_what_is_ahead_of_the_vehicle_is_seen() -> None:
    """One metre ahead of the vehicle, in the axes of the sensor; and upside down, to its left."""
    for mount, point, seen in (
        ((0.0, 0.0, 90.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)),  # the sensor's x axis points left
        ((0.0, 0.0, 180.0), (-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        ((180.0, 0.0, 0.0), (0.0, -1.0, -0.5), (0.0, 1.0, 0.5)),
        ((0.0, 90.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),  # it looks down, so its z axis points ahead
    ):
        np.testing.assert_allclose(turned(np.array([point]), mount_rotation(mount))[0], seen, atol=1e-9)


def test_misses_stay_misses() -> None:
    misses = np.array([[np.nan] * 3, [np.inf] * 3, [0.0] * 3], np.float32)
    found = turned(misses, mount_rotation((10.0, 20.0, 30.0)))
    assert not np.isfinite(found[:2]).any() and not found[2].any()


def test_what_is_no_mount_is_told() -> None:
    assert mount_trouble(UPRIGHT) is mount_trouble((-180, 90, 3)) is None
    for mount in ((0.0, 0.0), (0.0, 0.0, 181.0), (float("nan"), 0.0, 0.0)):
        assert "each from -180 to 180" in str(mount_trouble(mount))
    for mount in ((3.14, 0.0, 0.0), (0.0, -1.5708, 0.0)):
        assert "looks like radians" in str(mount_trouble(mount))
