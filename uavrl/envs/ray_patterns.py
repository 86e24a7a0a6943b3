"""The rays of LiDARs and cameras: where they point, when they are fired, and files of one's own."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uavrl.envs.array_file import load_npy
from uavrl.errors import UavrlError
from uavrl_onboard.geometry import spherical
from uavrl_onboard.lidar.mount import mount_rotation, turned
from uavrl_onboard.lidar.vlp16 import AZIMUTH_STEP, AZIMUTH_STEPS, FIRING_TIMES, firing_directions

ALL_AROUND = (-180.0, 180.0)  # degrees
MOST_RAYS = 300_000  # of a scan
MOST_SCANS = 200  # of a pattern
_LARGEST_FILE = 2**28  # bytes
_MID360_RAYS, _MID360_SCANS = 20_000, 40
_MID360_TURNS, _MID360_SWEEPS = 181.3, 9.86  # per s: no whole numbers, so that no scan repeats the one before
_MID360_ELEVATION = (-7.0, 52.0)
_MID360_SWEEP = (19.6, 25.65, 2.4)  # degrees: of the middle, and by the cosine of the sweep and its square
_MID360_BEAMS = (2.3, 0.6, -1.2, -2.9)  # degrees that each is off ahead; behind as much to the other side
_MID360_WIDENED = 0.32  # how much farther apart they are at the top, and less far at the bottom
_D435_PIXELS, _D435_HALF = (106, 60), (43.5, 29.0)  # columns and rows; degrees to the side and up


class SensorRays(NamedTuple):
    """The rays of S scans, after which a sensor repeats itself; S is 1 for most."""

    directions: np.ndarray  #: ``float32 [S, R, 3]``, unit vectors in firing order: x forward, y left, z up
    times: np.ndarray  #: ``float64 [R]``, s after the first ray
    azimuths: np.ndarray  #: ``float64 [S, C]``, rad clockwise from straight ahead, of C groups of R / C rays in turn


def vlp16_rays() -> SensorRays:
    """The rays of a VLP-16, sixteen lasers in each firing cycle."""
    return SensorRays(firing_directions()[None], FIRING_TIMES, np.arange(AZIMUTH_STEPS)[None] * AZIMUTH_STEP)


def grid_rays(
    elevations: Sequence[float], steps: int, azimuth: tuple[float, float] = ALL_AROUND, rate: float = 10.0
) -> SensorRays:
    """The rays of beams at ``elevations`` in degrees, in each of ``steps`` between two azimuths in degrees.

    Examples:
        >>> grid_rays([0.0], 4).directions[0].round(3).tolist()  # clockwise seen from above
        [[1.0, -0.0, 0.0], [0.0, -1.0, 0.0], [-1.0, -0.0, 0.0], [-0.0, 1.0, 0.0]]
    """
    right, left = np.radians(azimuth)
    if azimuth == ALL_AROUND:
        clockwise = np.arange(steps) * (math.tau / steps)
    elif steps == 1:
        clockwise = np.array([-(left + right) / 2])
    else:
        clockwise = np.linspace(-left, -right, steps)
    elevation = np.radians(np.tile(elevations, steps))
    times = np.repeat(np.arange(steps) / (steps * rate), len(elevations))
    towards = _towards(np.repeat(clockwise, len(elevations)), elevation)
    return SensorRays(towards[None], times, clockwise[None])


def mid360_rays(period: float) -> SensorRays:
    """Four beams of a Mid-360, which fire one after the other, turn to the left, and sweep up and down.

    Source: fitted to three scans of real ones; `studies/mid360_pattern.py` compares it with them.
    """
    count = np.arange(_MID360_SCANS * _MID360_RAYS)
    times = count * (period / _MID360_RAYS)
    azimuth, swept = math.tau * _MID360_TURNS * times, np.cos(math.tau * _MID360_SWEEPS * times)
    middle, by_cosine, by_square = _MID360_SWEEP
    beams = np.array(_MID360_BEAMS)[count % len(_MID360_BEAMS)] * (1.0 + _MID360_WIDENED * swept)
    elevation = middle + by_cosine * swept + by_square * swept**2 + beams * np.cos(azimuth)
    elevation = np.interp(elevation, [elevation.min(), elevation.max()], _MID360_ELEVATION)  # as the manual has it
    clockwise = -azimuth % math.tau
    towards = _towards(clockwise, np.radians(elevation)).reshape(_MID360_SCANS, _MID360_RAYS, 3)
    groups = clockwise.reshape(_MID360_SCANS, -1, len(_MID360_BEAMS))[..., 0]  # of which a stride keeps all beams
    return SensorRays(towards, times[:_MID360_RAYS], groups)


def d435_rays() -> SensorRays:
    """The pixels of a pinhole camera, row by row from the upper left, exposed at once."""
    columns, rows = _D435_PIXELS
    aside, up = np.tan(np.radians(_D435_HALF))
    z, y = (
        part.ravel()
        for part in np.meshgrid(np.linspace(up, -up, rows), np.linspace(aside, -aside, columns), indexing="ij")
    )
    return rays_in_turn(np.stack([np.ones_like(y), y, z], -1)[None], 0.0)


def rays_in_turn(directions: np.ndarray, period: float) -> SensorRays:
    """Rays in any directions ``[S, R, 3]``, fired one after the other at equal intervals."""
    unit = (directions / np.linalg.norm(directions, axis=-1, keepdims=True)).astype(np.float32)
    times = np.arange(unit.shape[1]) * (period / unit.shape[1])
    return SensorRays(unit, times, _clockwise(unit))


def strided(name: str, rays: SensorRays, stride: int) -> SensorRays:
    """Fire every n-th group of rays of one azimuth, and those one step later in the next scan."""
    scans, groups = rays.azimuths.shape
    if not (count := groups // stride):
        raise UavrlError(
            f"The LiDAR {name!r} has {groups} azimuth steps, fewer than its stride of {stride}: lower stride, or "
            f"trainer.lidar_stride."
        )
    parts = rays.directions.reshape(scans, groups, -1, 3)[:, : count * stride].reshape(scans, count, stride, -1, 3)
    directions = np.moveaxis(parts, 2, 1).reshape(scans * stride, -1, 3)
    azimuths = np.moveaxis(rays.azimuths[:, : count * stride].reshape(scans, count, stride), 2, 1)
    times = rays.times.reshape(groups, -1)[: count * stride : stride].ravel()
    return SensorRays(np.ascontiguousarray(directions), times, azimuths.reshape(scans * stride, count))


def mounted(rays: SensorRays, mount: Sequence[float]) -> SensorRays:
    """The rays of a sensor that is mounted otherwise, in the vehicle's axes; each has an azimuth of its own then."""
    directions = turned(rays.directions, mount_rotation(mount))
    return SensorRays(directions, rays.times, _clockwise(directions))


def read_directions(name: str, path: Path) -> np.ndarray:
    """The directions ``[S, R, 3]`` in a file of one's own."""
    told = f"The LiDAR {name!r}: its directions {path}"
    rows = "rows must be x, y, z, or azimuth and elevation in degrees"
    if (suffix := path.suffix.lower()) not in (".csv", ".txt", ".npy"):
        raise UavrlError(f"{told} must be a .csv, .txt or .npy file.")
    try:
        size = path.stat().st_size
    except OSError as error:
        raise UavrlError(f"{told} cannot be read ({error.strerror}): name a file that is there.") from error
    if not path.is_file():  # but a folder or a device, which may have no end
        raise UavrlError(f"{told} must be a file, not a folder or a device.")
    if size > _LARGEST_FILE:
        raise UavrlError(f"{told} have more than {_LARGEST_FILE:,} bytes, which no sensor needs: give fewer rays.")
    try:
        if suffix == ".npy":
            found = load_npy(path)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # of an empty file, which is refused below
                found = np.loadtxt(path, delimiter=",", ndmin=2, encoding="utf-8-sig")  # as Excel writes it
    except (OSError, ValueError, EOFError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise UavrlError(f"{told} cannot be read ({reason}): {rows}.") from error
    if found.ndim == 2:
        found = found[None]
    if found.dtype.kind not in "fiu" or found.ndim != 3 or found.shape[-1] not in (2, 3) or not found.size:
        raise UavrlError(f"{told} have the shape {list(found.shape)} and type {found.dtype}: {rows}.")
    scans, rays, numbers = found.shape
    if rays > MOST_RAYS or scans > MOST_SCANS or scans * rays > 20 * MOST_RAYS:
        raise UavrlError(
            f"{told} are {scans} scans of {rays:,} rays; at most {MOST_SCANS} scans, {MOST_RAYS:,} rays in each and "
            f"{20 * MOST_RAYS:,} in all are possible."
        )
    found = found.astype(np.float64)
    if not np.isfinite(found).all():
        raise UavrlError(f"{told} hold NaN or infinite values: every ray needs a direction.")
    if numbers == 2:
        if np.abs(found[..., 1]).max() > 90 + 1e-6:
            raise UavrlError(
                f"{told} hold elevations of up to {np.abs(found[..., 1]).max():g} degrees, and 90 is straight up: the "
                f"columns are azimuth and elevation; of zenith angles write 90 - zenith."
            )
        found = spherical(*np.radians(np.moveaxis(found, -1, 0)))
    largest = np.abs(found).max(-1, keepdims=True)
    if not (largest > 1e-6).all():
        raise UavrlError(f"{told} hold a ray of length 0: every ray needs a direction.")
    return np.asarray(found / largest)  # whose squares can be added


def _clockwise(directions: np.ndarray) -> np.ndarray:
    """The azimuths of directions ``[S, R, 3]``, rad clockwise from straight ahead."""
    return np.arctan2(-directions[..., 1], directions[..., 0]).astype(np.float64) % math.tau


def _towards(clockwise: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Unit vectors ``float32 [R, 3]``."""
    return spherical(-clockwise, elevation).astype(np.float32)
