"""The firing pattern of the Velodyne VLP-16 at 10 Hz (Velodyne VLP-16 user manual 63-9243)."""

import math

import numpy as np

from uavrl_onboard.geometry import spherical
from uavrl_onboard.perception.cells import AZIMUTH_STEP

__all__ = [
    "AZIMUTH_STEP",
    "AZIMUTH_STEPS",
    "CYCLE",
    "FIRING_TIMES",
    "LASER_ELEVATIONS",
    "LASER_INTERVAL",
    "NUM_RAYS",
    "firing_directions",
]

LASER_ELEVATIONS = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
"""Elevation of each laser id in degrees, in the order in which the lasers fire."""

AZIMUTH_STEPS = 1808  # firing cycles in one revolution at 10 Hz
NUM_RAYS = AZIMUTH_STEPS * len(LASER_ELEVATIONS)
"""Rays in one scan: 28,928."""

CYCLE = 55.296e-6  # s, all 16 lasers and the recharge time
LASER_INTERVAL = 2.304e-6  # s, from one laser to the next
_SPIN_RATE = 2.0 * math.pi * 10.0  # rad/s

FIRING_TIMES: np.ndarray = (
    np.arange(AZIMUTH_STEPS)[:, None] * CYCLE + np.arange(len(LASER_ELEVATIONS)) * LASER_INTERVAL
).reshape(-1)
"""Time of each ray after the first one in seconds, ``float64 [28928]``."""


def firing_directions() -> np.ndarray:
    """Returns the unit directions ``float32 [28928, 3]`` of one scan in the order in which the sensor fires.

    The order is firing cycle (1808), then laser id (16). The sensor starts straight ahead and turns clockwise seen from
    above, as the VLP-16 does: 0.1991° from cycle to cycle and 0.0083° from laser to laser within a cycle.
    """
    azimuth = _SPIN_RATE * FIRING_TIMES
    elevation = np.radians(np.tile(np.asarray(LASER_ELEVATIONS, dtype=np.float64), AZIMUTH_STEPS))
    return spherical(-azimuth, elevation).astype(np.float32)
