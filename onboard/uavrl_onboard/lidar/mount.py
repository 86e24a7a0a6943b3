"""How a LiDAR is mounted on the vehicle: its points are turned into the vehicle's axes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uavrl_onboard.geometry import quaternion, rotations_of

UPRIGHT = (0.0, 0.0, 0.0)
"""Roll, pitch and yaw of a sensor whose axes are the vehicle's."""
TILTED = 5.0
"""Degrees of tilt from which on a sensor does not see the same elevations on all sides; the simulator draws up to 3."""
_NEAR = 0.01  # of what looks like a half or a quarter turn in radians


def mount_trouble(mount: Sequence[float]) -> str | None:
    """Say what a mount should be instead; None where it is one.

    Examples:
        >>> mount_trouble((180.0, 0.0, 0.0))
        >>> mount_trouble((3.1416, 0.0, 0.0))
        'roll, pitch and yaw in degrees, for example [180,0,0]: 3.1416 looks like radians'
    """
    told = "roll, pitch and yaw in degrees, for example [180,0,0]"
    if len(mount) != 3 or not all(math.isfinite(each) and abs(each) <= 180.0 for each in mount):
        return f"{told}, each from -180 to 180"
    for each in mount:
        if any(abs(abs(each) - angle) < _NEAR for angle in (math.pi, math.pi / 2)):
            return f"{told}: {each:g} looks like radians"
    return None


def mount_rotation(mount: Sequence[float]) -> np.ndarray:
    """Return the rotation ``[3, 3]`` from the axes of a sensor to the vehicle's.

    Args:
        mount: roll, pitch and yaw of the sensor in the vehicle's axes (x forward, y left, z up) in degrees, as ``rpy``
            of a joint in a URDF: a positive pitch turns the sensor's x axis down, a positive yaw to the left.

    Examples:
        >>> (mount_rotation((0.0, 90.0, 0.0)) @ [1.0, 0.0, 0.0]).round(9).tolist()
        [0.0, 0.0, -1.0]
    """
    w, x, y, z = quaternion(*(math.radians(each) for each in mount))
    return np.asarray(rotations_of(np.array([[x, y, z, w]]))[0])


def mount_tilt(mount: Sequence[float]) -> float:
    """Return how far the axis that a sensor turns about is from the vehicle's, in degrees from 0 to 90.

    Examples:
        >>> [round(mount_tilt(mount), 6) for mount in ((180.0, 0.0, 30.0), (0.0, 25.0, 0.0), (180.0, -25.0, 0.0))]
        [0.0, 25.0, 25.0]
    """
    return rotation_tilt(mount_rotation(mount))


def rotation_tilt(rotation: np.ndarray) -> float:
    """Return the same of a rotation ``[3, 3]``."""
    return math.degrees(math.acos(min(abs(float(rotation[2, 2])), 1.0)))


def turned(points: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return points ``[P, 3]`` in other axes, of the same type; NaN stays NaN."""
    with np.errstate(invalid="ignore"):  # infinite coordinates of misses become NaN
        return np.asarray(points @ rotation.T.astype(points.dtype))
