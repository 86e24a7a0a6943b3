"""The LiDARs and depth cameras that can be simulated: records of their rays, rates, ranges and flaws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from uavrl.envs.limits import require_finite
from uavrl.envs.ray_patterns import (
    ALL_AROUND,
    MOST_RAYS,
    SensorRays,
    d435_rays,
    grid_rays,
    mid360_rays,
    mounted,
    rays_in_turn,
    read_directions,
    strided,
    vlp16_rays,
)
from uavrl.errors import UavrlError, did_you_mean
from uavrl_onboard.lidar.mount import UPRIGHT, mount_trouble
from uavrl_onboard.perception.view import View

__all__ = ["SENSORS", "LidarSensor", "SensorRays", "lidar_sensor"]

LEAST_RATE = 10.0  # Hz, at which policies act: a slower sensor would show them one scan twice
LONGEST_STRIDE = 50
STEEPEST = 89.9  # degrees: the azimuth of a ray that is steeper is rounding


@dataclass(frozen=True)
class LidarSensor:
    """A LiDAR or a depth camera.

    Its rays are a grid of ``azimuth_steps`` by ``elevations``, or the rows of a file of ``directions``. A grid fires
    clockwise seen from above, all elevations of a step at once; a full turn starts straight ahead.

    Args:
        name: What messages and contracts call it.
        elevations: Elevation of each beam in degrees, in the order in which a step fires them.
        azimuth_steps: Number of steps in a scan.
        azimuth: Right and left border of the horizontal field of view in degrees; the left is positive.
        directions: A CSV or NPY file. Its rows are x, y, z (of any length), or azimuth and elevation in degrees, in
            firing order. An NPY file of shape ``[S, R, 3]`` holds S scans that follow each other.
        rate: Scans per second.
        max_range: Farthest range in m.
        blind_distance: Shortest range in m.
        range_noise: Standard deviation of the range error in m.
        stride: With n, a scan has only every n-th azimuth step, and the next scan those one step later. Steps at the
            end of a turn that do not make n are left out. A sensor without steps has every n-th ray, and the Mid-360
            every n-th group of its four beams. Of a pattern of several scans, the next one comes after n scans.
        mount: Roll, pitch and yaw of the sensor in the vehicle's axes in degrees, as ``rpy`` in a URDF: (180, 0, 0)
            hangs upside down, (0, 20, 0) looks forward and down. Its rays and points are in the vehicle's axes.
        pattern: How the rays are made; own sensors have a grid.

    Raises:
        UavrlError: for values out of range, for neither or both kinds of rays, and for files that hold no directions.

    Examples:
        >>> LidarSensor("mine", elevations=(-10.0, 0.0, 10.0), azimuth_steps=360).num_rays
        1080
    """

    name: str = "own"
    elevations: tuple[float, ...] | None = None
    azimuth_steps: int | None = None
    azimuth: tuple[float, float] = ALL_AROUND
    directions: str | None = None
    rate: float = 10.0
    max_range: float = 100.0
    blind_distance: float = 0.0
    range_noise: float = 0.0
    stride: int = 1
    mount: tuple[float, ...] = UPRIGHT
    pattern: Literal["grid", "vlp16", "rosette", "camera"] = "grid"
    _stamp: tuple[int, int] | None = field(default=None, init=False, repr=False)  # of the file: when changed, its size

    def __post_init__(self) -> None:
        """Refuse a sensor that nothing can be seen with."""
        require_finite(self, ("rate", "max_range", "blind_distance", "range_noise", "azimuth", "mount"))
        right, left = self.azimuth if len(self.azimuth) == 2 else (0.0, 0.0)
        rules = {
            f"rate must be at least {LEAST_RATE:g} Hz, at which policies act, and at most 1000": (
                LEAST_RATE <= self.rate <= 1000
            ),
            "max_range must be above 0 and at most 1000 m": 0 < self.max_range <= 1000,
            "blind_distance must be 0 or more, and below max_range": 0 <= self.blind_distance < self.max_range,
            "range_noise must be in [0, 100] m": 0 <= self.range_noise <= 100,
            f"stride must be a whole number from 1 to {LONGEST_STRIDE}": (
                isinstance(self.stride, int)
                and not isinstance(self.stride, bool)
                and 1 <= self.stride <= LONGEST_STRIDE
            ),
            "azimuth must be two angles in degrees, the right one first, for example [-45, 45]": (
                -180 <= right < left <= 180
            ),
        }
        for rule, holds in rules.items():
            if not holds:
                value = getattr(self, rule.split()[0])
                raise UavrlError(f"The LiDAR {self.name!r}: {rule}; got {value}.")
        if (trouble := mount_trouble(self.mount)) is not None:
            raise UavrlError(f"The LiDAR {self.name!r}: mount must be {trouble}; got {list(self.mount)}.")
        if self.pattern == "grid":
            self._require_rays()
        if self.stride > 1:
            rays_of(self)  # which refuses too large a stride

    def _require_rays(self) -> None:
        own = "give elevations and azimuth_steps, or a file of directions"
        if (self.directions is None) == (self.elevations is None):
            raise UavrlError(f"The LiDAR {self.name!r} needs one kind of rays: {own}.")
        if self.elevations is None:
            if self.azimuth_steps is not None or self.azimuth != ALL_AROUND:
                raise UavrlError(
                    f"The LiDAR {self.name!r} takes its rays from its file of directions: leave azimuth and "
                    "azimuth_steps out, or give elevations instead of directions."
                )
            object.__setattr__(self, "_stamp", _stamp_of(Path(str(self.directions))))
            rays_of(self)  # which reads the file
            return
        require_finite(self, ("elevations",))
        steps = self.azimuth_steps
        if not self.elevations or max(map(abs, self.elevations)) > 90:
            raise UavrlError(
                f"The LiDAR {self.name!r}: elevations must be a list of angles in [-90, 90] degrees; "
                f"got {list(self.elevations)}."
            )
        if not isinstance(steps, int) or isinstance(steps, bool) or steps < 1:
            raise UavrlError(
                f"The LiDAR {self.name!r}: azimuth_steps must be a whole number, 1 or more; got {steps!r}."
            )
        if steps * len(self.elevations) > MOST_RAYS:
            raise UavrlError(
                f"The LiDAR {self.name!r} would cast {steps * len(self.elevations):,} rays, and at most {MOST_RAYS:,} "
                "are possible: lower azimuth_steps."
            )

    @property
    def fires_as_vlp16(self) -> bool:
        """Whether its rays are those of a VLP-16 that is mounted as usual."""
        return self.pattern == "vlp16" and self.mount == UPRIGHT

    @property
    def num_rays(self) -> int:
        """Rays in one scan."""
        return int(self.rays.directions.shape[1])

    @property
    def rays(self) -> SensorRays:
        """All rays; computed once for all equal sensors, and read-only."""
        return rays_of(self)

    @property
    def repeats(self) -> bool:
        """Whether each scan has the same rays, apart from ``stride``.

        Examples:
            >>> SENSORS["os0_32"].repeats, SENSORS["mid360"].repeats
            (True, False)
        """
        return len(self.rays.directions) == self.stride

    @property
    def field_of_view(self) -> tuple[float, float, float, float]:
        """Right, left, lowest and highest direction of any ray in degrees, rounded to a tenth.

        The left one is beyond 180 if the sensor looks backwards.

        Examples:
            >>> SENSORS["d435"].field_of_view
            (-43.5, 43.5, -29.0, 29.0)
            >>> replace(SENSORS["d435"], mount=(0, 0, 180)).field_of_view
            (136.5, 223.5, -29.0, 29.0)
        """
        x, y, z = self.rays.directions.reshape(-1, 3).astype(float).T
        azimuth, elevation = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
        aside = np.abs(elevation) < STEEPEST
        around = np.sort(azimuth[aside] if aside.any() else azimuth)
        gaps = np.diff(around, append=around[0] + 360)
        usual = np.median(gaps[gaps > 0.01]) if (gaps > 0.01).any() else 0.0
        sides = ALL_AROUND
        if gaps.max() >= min(max(10.0, 1.5 * usual), 180.0):
            widest = int(gaps.argmax())  # the sensor looks from its left end to its right one
            right = float(around[(widest + 1) % len(around)])
            sides = right, right + 360.0 - float(gaps[widest])
        rounded = [round(angle, 1) + 0.0 for angle in (*sides, float(elevation.min()), float(elevation.max()))]
        return rounded[0], rounded[1], rounded[2], rounded[3]


def _spread(low: float, high: float, count: int) -> tuple[float, ...]:
    """Beams at equal distances, the highest first, as Ouster and Hesai number theirs."""
    return tuple(np.linspace(high, low, count).round(4).tolist())


# The beams of one firing step share its azimuth here. In the devices they lie up to 22 degrees apart in an OS0, 9 in an
# OS1 (metadata in ouster-sdk's tests) and 0.2 in an XT32 (PandarXT32.csv of nebula).
SENSORS: Mapping[str, LidarSensor] = {
    each.name: each
    for each in (
        # Velodyne VLP-16 user manual 63-9243. The thesis's sensor is ideal; the data sheet has a minimum range of 0.9 m
        # (recordings hold points from 0.5 m) and an accuracy of 3 cm, which perception.lidar can switch on. Beams and
        # times are those of ROS's velodyne_pointcloud, too (VLP16_FIRING_TOFFSET, VLP16_DSR_TOFFSET).
        LidarSensor("vlp16", pattern="vlp16", max_range=100.0),
        # Ouster OS0 data sheet, Rev 06: 90 degrees, 0.3 to 50 m, precision 1.5 to 5 cm; mode 1024 x 10. Eight OS0
        # in ouster-sdk's tests reach from 43.9 to 46.2 degrees up and from 45.4 to 46.3 down. The shortest range is a
        # setting of the device: 0, 30 or 50 cm (min_range_threshold_cm).
        LidarSensor("os0_32", _spread(-45, 45, 32), 1024, max_range=50.0, blind_distance=0.3, range_noise=0.015),
        LidarSensor("os0_128", _spread(-45, 45, 128), 1024, max_range=50.0, blind_distance=0.3, range_noise=0.015),
        # Ouster OS1 data sheet, Rev 06: 0.3 to 120 m, precision 0.7 to 5 cm; mode 1024 x 10. Its 45 degrees are a round
        # number: five OS1-128 in ouster-sdk's tests span 42.4 to 43.0 degrees.
        LidarSensor("os1_64", _spread(-21.2, 21.2, 64), 1024, max_range=120.0, blind_distance=0.3, range_noise=0.007),
        # Hesai XT32 user manual: 32 channels of 1 degree, 0.18 degrees at 10 Hz, 0.05 to 120 m, precision 0.5 cm. The
        # calibrated device of nebula's PandarXT32.csv is within 0.08 degrees of these beams.
        LidarSensor("xt32", _spread(-16, 15, 32), 2000, max_range=120.0, blind_distance=0.05, range_noise=0.005),
        # Livox Mid-360 user manual v1.2: 360 x 59 degrees, 200,000 points/s, 40 m at 10 % reflectivity, blind up to
        # 0.1 m, range error 2 cm at 10 m and 3 cm at 0.2 m. The trajectory was fitted to scans of real ones
        # (kompass-core's livox_pointcloud_sample_1.json, and two of QuintinUmi/mid360_hikcamera_calibration), whose
        # elevations are 0.9 to 1.6 degrees off (root mean square; studies/mid360_pattern.py).
        LidarSensor("mid360", pattern="rosette", max_range=40.0, blind_distance=0.1, range_noise=0.02),
        # Slamtec RPLIDAR S2 data sheet: one plane, 32,000 samples/s at 10 Hz, 0.05 to 30 m, accuracy 3 cm.
        LidarSensor("rplidar", (0.0,), 3200, max_range=30.0, blind_distance=0.05, range_noise=0.03),
        # Intel RealSense D400 data sheet: D435, 87 x 58 degrees of depth, 848 x 480 pixels (here each eighth of a row
        # and of a column), up to 10 m (3 m are the ideal range), from 0.2 m on at this resolution, 2 % at 2 m.
        LidarSensor("d435", pattern="camera", rate=30.0, max_range=10.0, blind_distance=0.2, range_noise=0.02),
    )
}
"""The sensors that ``env.lidar=NAME`` chooses."""


def lidar_sensor(given: Any) -> LidarSensor:
    """Return the sensor that a value of ``env.lidar`` means: a name, a YAML file, its settings, or the sensor itself.

    Raises:
        UavrlError: for an unknown name or setting, a file that cannot be read, and values out of range.

    Examples:
        >>> lidar_sensor("os0_128").num_rays
        131072
        >>> lidar_sensor({"elevations": [-5, 0, 5], "azimuth_steps": 180}).field_of_view
        (-180.0, 180.0, -5.0, 5.0)
    """
    given = sensor_settings(given)
    if isinstance(given, LidarSensor):
        return given
    if isinstance(given, Mapping):
        return _of_settings(given)
    if isinstance(given, str) and given in SENSORS:
        return SENSORS[given]
    near = did_you_mean(str(given), SENSORS, ": ", "for your own give a YAML file, FILE.yaml.")
    raise UavrlError(f"A LiDAR must be one of {', '.join(SENSORS)}, got {given!r}{near}")


def sensor_settings(given: Any) -> Any:
    """Return the settings in a YAML file, so that they do not depend on the file any more; anything else as it is."""
    if not isinstance(given, str) or Path(given).suffix.lower() not in (".yaml", ".yml"):
        return given
    path = Path(given).expanduser()
    try:
        with path.open(encoding="utf-8") as file:
            settings = yaml.safe_load(file.read(2**20))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise UavrlError(f"The LiDAR's file {given} cannot be read ({reason}): check it.") from error
    if not isinstance(settings, Mapping):
        raise UavrlError(f"The LiDAR's file {given} must hold settings such as 'azimuth_steps: 360', and does not.")
    if settings.get("name") is None:
        settings = {**settings, "name": path.stem}
    if isinstance(directions := settings.get("directions"), str):
        settings["directions"] = str((path.parent / Path(directions).expanduser()).resolve())
    return settings


def _of_settings(settings: Mapping[Any, Any]) -> LidarSensor:
    known = ["like", *(each.name for each in fields(LidarSensor) if each.init and each.name != "pattern")]
    values: dict[str, Any] = {}
    for key, value in settings.items():
        if key not in known:
            takes = f"it takes {', '.join(known)}."
            raise UavrlError(f"A LiDAR has no setting {key!r}{did_you_mean(str(key), known, ': ', takes)}")
        if value is None:
            continue
        if key in ("elevations", "azimuth", "mount") and not isinstance(value, list | tuple):
            raise UavrlError(f"The LiDAR's {key} must be a list of degrees, got {value!r}.")
        if key in ("like", "name", "directions") and not isinstance(value, str):
            raise UavrlError(f"The LiDAR's {key} must be a text, got {value!r}.")
        values[key] = tuple(value) if isinstance(value, list | tuple) else value
    if values.get("name") in SENSORS:
        raise UavrlError(
            f"The name {values['name']} belongs to a LiDAR of uavrl: rename the file, or set another name in it."
        )
    like = values.pop("like", None)
    return LidarSensor(**values) if like is None else _variant(like, values)


def _variant(like: str, values: dict[str, Any]) -> LidarSensor:
    """A sensor of ours with other values."""
    if like not in SENSORS:
        advice = "choose one of them, or leave like out and describe all of the sensor."
        raise UavrlError(
            f"The LiDAR's like must be one of {', '.join(SENSORS)}, got {like!r}"
            f"{did_you_mean(like, SENSORS, ': ', advice)}"
        )
    known = SENSORS[like]
    own = ("elevations", "azimuth_steps", "azimuth") if known.pattern != "grid" else ()
    fixed = [key for key in (*own, "directions") if key in values]
    if fixed:
        raise UavrlError(f"A LiDAR like {like} has its rays: leave {' and '.join(fixed)} out, or leave like out.")
    if "rate" in values and known.pattern != "grid":
        raise UavrlError(f"A LiDAR like {like} has its rate, which its rays depend on: leave rate out.")
    return replace(known, **{"name": "own"} | values)


def sensor_of_view(name: str, view: View) -> LidarSensor:
    """Return a sensor with a ray in each degree of a field of view, of which nothing else is known.

    Examples:
        >>> sensor_of_view("mine", (-180.0, 180.0, -7.0, 52.0)).num_rays
        21600
    """
    right, left, low, high = view
    elevations = tuple(np.linspace(low, high, math.ceil(high - low) + 1).tolist())
    steps, middle, half = max(1, math.ceil(left - right)), (right + left) / 2, max((left - right) / 2, 0.05)
    ahead = (-half, half)  # as one that looks ahead, and is turned
    around = ahead if left - right < 360.0 else ALL_AROUND
    mount = UPRIGHT if middle == 0.0 else (0.0, 0.0, math.remainder(middle, 360.0))
    return LidarSensor(name, elevations, steps, around, mount=mount)


def _stamp_of(path: Path) -> tuple[int, int] | None:
    """Return what tells one version of a file from another, None if there is none."""
    with suppress(OSError):
        found = path.stat()
        return found.st_mtime_ns, found.st_size
    return None


@lru_cache(maxsize=16)
def rays_of(sensor: LidarSensor) -> SensorRays:
    """Return the rays of a sensor."""
    rays = _all_rays(sensor)
    if sensor.stride > 1:
        rays = strided(sensor.name, rays, sensor.stride)
    if sensor.mount != UPRIGHT:
        rays = mounted(rays, sensor.mount)
    for array in rays:
        array.setflags(write=False)
    return rays


def _all_rays(sensor: LidarSensor) -> SensorRays:
    if sensor.pattern == "vlp16":
        return vlp16_rays()
    if sensor.pattern == "rosette":
        return mid360_rays(1.0 / sensor.rate)
    if sensor.pattern == "camera":
        return d435_rays()
    if sensor.directions is not None:
        return rays_in_turn(read_directions(sensor.name, Path(sensor.directions)), 1.0 / sensor.rate)
    assert sensor.elevations is not None and sensor.azimuth_steps is not None
    return grid_rays(sensor.elevations, sensor.azimuth_steps, sensor.azimuth, sensor.rate)
