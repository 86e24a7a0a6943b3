"""A LiDAR, cast on Embree; by default the Velodyne VLP-16 (Chansuparp (2022), section 3.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from uavrl.envs.lidar_flaws import add_noise, hide_sector
from uavrl.envs.limits import OrMapping, require_finite, settings
from uavrl.envs.ray_culling import RayCuller
from uavrl.envs.sensors import LidarSensor, lidar_sensor, sensor_settings
from uavrl.envs.vehicle_params import VehicleParams
from uavrl.errors import UavrlError, extras
from uavrl_onboard.geometry import turn_about, yaw_rotation
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.perception.motion.rays import far_ray_indices
from uavrl_onboard.perception.view import View, is_view

with extras():
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

__all__ = ["Lidar", "LidarConfig"]

LARGEST_RANGE = 1e6  # m
_CULLED_RANGE = 10.0  # m: up to this range, rays that pass no triangle in range are not cast


@dataclass
class LidarConfig:
    """Which sensor scans, how far, and with which flaws. The defaults are the thesis's ideal sensor.

    Args:
        max_range: farthest range in metres, at most the sensor's own. Cut to the circumradius of the reduction (4 m),
            `uavrl.transforms.icosahedron.truncated_icosahedron` gives the identical result for less than half the time.
        min_range: points nearer than this are not reported, in metres; 0 is off. None: the sensor's blind distance,
            which is 0 for the VLP-16; its data sheet has 0.9.
        range_noise: standard deviation of the range error in metres; 0 is off. None: the sensor's own, which is 0 for
            the VLP-16; about 0.01 for the device.
        dropout: probability in [0, 1) that a hit is not reported.
        motion_distortion: whether the sensor moves on during a spin.
        far_range: to which the rays of one direction in each degree reach at least, in metres, for what looks farther
            and needs fewer rays, as :class:`uavrl.transforms.MovingObjects` does; of a sensor whose rays change from
            scan to scan, all do. None: as far as the others.
        sensor: a name of :data:`uavrl.envs.sensors.SENSORS`, a YAML file, whose settings are then kept, the settings of
            a :class:`uavrl.envs.LidarSensor`, or one itself.
        trained_view: the field of view that a policy's cells read, where the policy was trained with another sensor:
            the rightmost, leftmost, lowest and highest direction, degrees. None: they read the whole scan.

    Examples:
        >>> LidarConfig(max_range=4.0, range_noise=0.01).max_range
        4.0
    """

    max_range: Annotated[float, Field(le=1000)] = 100.0
    min_range: float | None = None
    range_noise: Annotated[float, Field(le=100)] | None = None
    dropout: float = 0.0
    motion_distortion: bool = False
    far_range: Annotated[float, Field(gt=0, le=1000)] | None = None
    sensor: Any = "vlp16"
    trained_view: View | None = None

    def __post_init__(self) -> None:
        """Checks the values."""
        self.sensor = sensor_settings(self.sensor)
        optional = ("min_range", "range_noise", "far_range")
        require_finite(self, ("max_range", "dropout", *(key for key in optional if getattr(self, key) is not None)))
        if not 0.0 < self.max_range <= LARGEST_RANGE:
            raise ValueError(
                f"max_range must be a positive length in metres, at most {LARGEST_RANGE:g}, got {self.max_range}."
            )
        if self.min_range is not None and not 0.0 <= self.min_range < self.max_range:
            raise ValueError(f"min_range must be in [0, max_range) metres, got {self.min_range}.")
        if self.far_range is not None and not 0.0 < self.far_range <= LARGEST_RANGE:
            raise ValueError(
                f"far_range must be a positive length in metres, at most {LARGEST_RANGE:g}, or None, "
                f"got {self.far_range}."
            )
        if self.range_noise is not None and self.range_noise < 0.0:
            raise ValueError(f"range_noise must be a standard deviation in metres, 0 or more, got {self.range_noise}.")
        if not 0.0 <= self.dropout < 1.0:
            raise ValueError(f"dropout must be a probability in [0, 1), got {self.dropout}.")
        if self.trained_view is not None and not is_view(self.trained_view):
            raise ValueError(
                "trained_view must be the rightmost, leftmost, lowest and highest direction in degrees, got "
                f"{list(self.trained_view)}."
            )
        if self.reach <= self.nearest:
            raise UavrlError(
                f"The LiDAR {self.device.name!r} sees nothing nearer than {self.nearest:g} m, and max_range is "
                f"{self.max_range:g} m: raise max_range."
            )

    @property
    def device(self) -> LidarSensor:
        """The sensor."""
        return lidar_sensor(self.sensor)

    @property
    def nearest(self) -> float:
        """Shortest range that is reported, m."""
        return self.device.blind_distance if self.min_range is None else self.min_range

    @property
    def noise(self) -> float:
        """Standard deviation of the range error, m."""
        return self.device.range_noise if self.range_noise is None else self.range_noise

    @property
    def reach(self) -> float:
        """Farthest range, m."""
        return min(self.max_range, self.device.max_range)

    @property
    def farthest(self) -> float:
        """Farthest range of the rays that look farther, m."""
        return max(self.reach, min(self.far_range or 0.0, self.device.max_range))


def _embree_scene(mesh: Mesh) -> EmbreeScene:
    scene = EmbreeScene()
    TriangleMesh(scene, mesh.vertices, mesh.faces)
    return scene


class Lidar:
    """Casts whole scans of any number of vehicles at once; the vehicles do not see each other.

    One Embree call casts a vehicle's rays against the static scene; at short range, only those that pass near a
    triangle (`uavrl.envs.ray_culling.RayCuller`), which changes no result. Moving bodies live in a small Embree scene
    of their own, in the body's frame: only rays that can hit a body's bounding sphere are carried there.

    Args:
        meshes: static triangle meshes in the world frame. May be empty.
        moving: the shape of all moving bodies in their own frame (x ahead, z up). None: nothing moves.
        config: range and imperfections of the sensor, or a dict of these; `LidarConfig()` if None.

    Attributes:
        sensor: the sensor that ``config`` names.
        directions: ``float32 [R, 3]``, read-only, of the rays of a scan; of the first one, if the pattern changes.

    Examples:
        A wall 2 m ahead, seen from the origin:

        >>> wall = Mesh([[2, -9, -9], [2, 9, -9], [2, 9, 9], [2, -9, 9]], [[0, 1, 2], [0, 2, 3]])
        >>> lidar = Lidar([wall])
        >>> cloud = lidar.scan(np.zeros((1, 3)), np.eye(3)[None])
        >>> cloud.shape, round(float(cloud[0, 0, 0]), 4), bool(np.isnan(cloud[0, 904 * 16]).all())
        ((1, 28928, 3), 2.0, True)
    """

    def __init__(
        self, meshes: Sequence[Mesh], moving: Mesh | None = None, config: OrMapping[LidarConfig] | None = None
    ) -> None:
        self.config = settings("config", LidarConfig, config)
        self.sensor = self.config.device
        rays = self.sensor.rays
        self.directions, self._times, self._azimuths = rays.directions[0], rays.times, rays.azimuths
        # [3, R] of each scan of the pattern: x, y and z contiguous, which numpy runs through fastest
        self._columns = [np.ascontiguousarray(directions.T) for directions in rays.directions]
        self._meshes, self._moving = list(meshes), moving
        self._static_scene = _embree_scene(Mesh.merge(self._meshes)) if self._meshes else None
        self._moving_scene = None if moving is None else _embree_scene(moving)
        self._moving_radius = 0.0 if moving is None else 1.01 * float(np.linalg.norm(moving.vertices, axis=-1).max())
        self._nearest, self._farthest = self.config.reach, self.config.farthest
        self._far_rays, self._reach = [], []
        for directions in rays.directions:
            far = np.empty(0, np.int64)
            if self._farthest > self._nearest:
                far = np.arange(len(directions))
                if self.sensor.repeats:
                    far = np.sort(far_ray_indices(directions))
            reach = np.full(len(directions), self._nearest, np.float32)
            reach[far] = self._farthest
            self._far_rays.append(far)
            self._reach.append(reach)
        self._culler: RayCuller | None = None
        # In a long scan all rays are candidates, and a moving sensor sweeps more: culling would not pay.
        if self._meshes and self._nearest <= _CULLED_RANGE and not self.config.motion_distortion:
            self._culler = RayCuller(Mesh.merge(self._meshes), self._nearest, self.sensor)

    def __reduce__(self) -> tuple[type[Lidar], tuple[list[Mesh], Mesh | None, LidarConfig]]:
        """Rebuilds the Embree scenes where the sensor is copied or sent to, as they cannot be pickled."""
        return type(self), (self._meshes, self._moving, self.config)

    def scan(
        self,
        positions: np.ndarray,
        rotations: np.ndarray,
        moving_poses: np.ndarray | None = None,
        *,
        velocities: np.ndarray | None = None,
        angular_velocities: np.ndarray | None = None,
        rng: np.random.Generator | None = None,
        flaws: Sequence[VehicleParams] | None = None,
        rays: slice | None = None,
        numbers: Sequence[int] | np.ndarray | None = None,
    ) -> np.ndarray:
        """Casts one scan per vehicle.

        With motion distortion, which alone needs velocities, the pose is that of the first firing and moves on with
        constant velocities, and each point is given in the sensor frame at its own firing, as the device gives it.
        Moving bodies stand still during a scan.

        Args:
            positions: ``[N, 3]``, sensor positions in the world in metres.
            rotations: ``[N, 3, 3]``, sensor-to-world rotation matrices.
            moving_poses: ``[K, 4]``, (x, y, z, yaw) of the moving bodies in metres and radians, or ``[N, K, 4]``, as
                each sensor meets them.
            velocities: ``[N, 3]``, world-frame velocities in m/s.
            angular_velocities: ``[N, 3]``, world-frame angular velocities in rad/s.
            rng: source of range noise and dropout, which need it.
            flaws: N vehicles with a blind sector, or with noise and dropout in place of those of ``config``.
            rays: those that are cast, without motion distortion; all others are NaN. None: all of a turn.
            numbers: of N sensors whose pattern changes, which scan of it each casts, from 0; None: all the first.

        Returns:
            ``float32 [N, R, 3]``, points in the sensor frame in metres, in the order of ``directions``; NaN in all
            three coordinates where a ray hits nothing. A fresh array each call. Its memory holds all x, all y and all z
            in turn, so it is not C-contiguous.

        Raises:
            ValueError: if an argument is missing, has a wrong shape, or holds NaN or infinite values.
        """
        positions = _checked("positions", positions, (-1, 3))
        rotations = _checked_rotations(rotations, len(positions))
        poses = self._checked_poses(moving_poses, len(positions))
        flaws = [VehicleParams()] * len(positions) if flaws is None else flaws
        noise = [self.config.noise if flaw.range_noise is None else flaw.range_noise for flaw in flaws]
        dropout = [self.config.dropout if flaw.dropout is None else flaw.dropout for flaw in flaws]
        if rng is None and (any(noise) or any(dropout)):
            raise ValueError("range_noise and dropout need rng, a numpy Generator, got None.")
        motion = None
        if self.config.motion_distortion and rays is None:
            motion = (
                _checked("velocities", velocities, positions.shape),
                _checked("angular_velocities", angular_velocities, positions.shape),
            )
        scans = len(self._columns)
        which = [0] * len(positions) if numbers is None or scans == 1 else [int(number) % scans for number in numbers]
        ranges = self._ranges(positions, rotations, poses, which, motion, rays)
        for seen, flaw, number in zip(ranges, flaws, which, strict=True):
            if flaw.blind_sector:
                hide_sector(seen, self._azimuths[number], flaw.blind_azimuth, flaw.blind_sector)
        if rng is not None:
            add_noise(ranges, noise, dropout, rng)
        if self.config.nearest > 0.0:
            np.putmask(ranges, ranges < self.config.nearest, np.nan)
        return self._points(ranges, which)

    def _checked_poses(self, moving_poses: np.ndarray | None, count: int) -> np.ndarray:
        """The poses of moving bodies as each of ``count`` sensors meets them, ``[N, K, 4]``."""
        moving_poses = np.empty((0, 4)) if moving_poses is None else np.asarray(moving_poses)
        poses = _checked("moving_poses", moving_poses, (-1, 4) if moving_poses.ndim < 3 else (count, -1, 4))
        poses = np.broadcast_to(poses, (count, *poses.shape[-2:]))
        if poses.size and self._moving_scene is None:
            raise ValueError("moving_poses needs a Lidar that was built with a moving mesh.")
        return poses

    def _ranges(
        self,
        positions: np.ndarray,
        rotations: np.ndarray,
        poses: np.ndarray,
        which: Sequence[int],
        motion: tuple[np.ndarray, np.ndarray] | None,
        rays: slice | None,
    ) -> np.ndarray:
        """The true ranges of all rays, ``float32 [N, R]`` in m; NaN where one hits nothing or is not cast.

        Args:
            positions: ``[N, 3]``.
            rotations: ``[N, 3, 3]``.
            poses: ``[N, K, 4]``, of moving bodies.
            which: scan of the pattern each of the N sensors casts.
            motion: velocities and angular velocities ``[N, 3]`` during the scan; None: all rays start at once.
            rays: those that are cast; None for all.
        """
        count = len(self._times)
        ranges = np.full((len(positions), count), np.nan, dtype=np.float32)
        first, last, _ = slice(None).indices(count) if rays is None else rays.indices(count)
        every = None if rays is None else np.arange(first, last)
        near = None if self._culler is None else self._culler.candidates(positions, rotations, which)
        for vehicle, (position, rotation) in enumerate(zip(positions, rotations, strict=True)):
            if near is not None:
                near[vehicle, self._far_rays[which[vehicle]]] = True
            columns, reach = self._columns[which[vehicle]], self._reach[which[vehicle]]
            origins, directions = position[:, None].astype(np.float32), rotation.astype(np.float32) @ columns
            speed = 0.0
            if motion is not None:
                velocity, angular_velocity = motion[0][vehicle], motion[1][vehicle]
                origins = origins + (velocity[:, None] * self._times).astype(np.float32)
                directions = _turned(directions, angular_velocity, self._times).astype(np.float32)
                speed = float(np.linalg.norm(velocity))
            if self._static_scene is not None:
                passing = every if near is None else np.flatnonzero(near[vehicle, first:last]) + first
                towards = _of_rays(passing, origins), _of_rays(passing, directions)
                _cast(self._static_scene, *towards, passing, ranges[vehicle], reach)
            reached = self._farthest + self._moving_radius + speed * self._times[-1]
            within = np.linalg.norm(poses[vehicle, :, :3] - position, axis=1) < reached
            for pose in poses[vehicle, within]:
                self._cast_body(pose, position, speed, origins, directions, ranges[vehicle], which[vehicle])
        if rays is not None:
            ranges[:, :first] = ranges[:, last:] = np.nan
        return ranges

    def _points(self, ranges: np.ndarray, which: Sequence[int]) -> np.ndarray:
        """The points ``[N, R, 3]`` at the ranges ``[N, R]`` of the scans of the pattern that N sensors cast."""
        if len(self._columns) == 1:
            return (self._columns[0][:, None] * ranges).transpose(1, 2, 0)
        points = np.empty((3, *ranges.shape), np.float32)
        for vehicle, number in enumerate(which):
            np.multiply(self._columns[number], ranges[vehicle], out=points[:, vehicle])
        return points.transpose(1, 2, 0)

    def _cast_body(
        self,
        pose: np.ndarray,
        position: np.ndarray,
        speed: float,
        origins: np.ndarray,
        directions: np.ndarray,
        ranges: np.ndarray,
        number: int,
    ) -> None:
        """Shortens the ranges of one vehicle's rays that hit one moving body, in the body's frame."""
        offset, radius = pose[:3] - position, self._moving_radius + speed * self._times[-1]
        gap = float(np.linalg.norm(offset))
        rays = self._far_rays[number] if gap > self._nearest + radius else None
        directions = _of_rays(rays, directions)
        if gap > radius:
            met = np.flatnonzero(offset.astype(np.float32) @ directions > math.sqrt(gap**2 - radius**2))
            directions, rays = _of_rays(met, directions), met if rays is None else rays[met]
        to_body = yaw_rotation(-pose[3]).astype(np.float32)
        from_body = to_body @ (_of_rays(rays, origins) - pose[:3, None].astype(np.float32))
        assert self._moving_scene is not None
        _cast(self._moving_scene, from_body, to_body @ directions, rays, ranges, self._reach[number])


def _of_rays(rays: np.ndarray | None, columns: np.ndarray) -> np.ndarray:
    """What some ``rays`` (None: all) have of ``columns [3, R]``, or of the one that stands for all ``[3, 1]``."""
    return columns if rays is None or columns.shape[1] == 1 else columns.take(rays, axis=1)


def _cast(
    scene: EmbreeScene,
    origins: np.ndarray,
    directions: np.ndarray,
    rays: np.ndarray | None,
    ranges: np.ndarray,
    reach: np.ndarray,
) -> None:
    """Shortens ``ranges [R]`` (NaN: nothing hit) of some ``rays`` (None: all) to what they hit within ``reach [R]``.

    ``origins`` and ``directions`` are those of these rays, ``[3, M]``; one origin ``[3, 1]`` may stand for all.
    """
    reach = reach if rays is None else reach.take(rays)
    lengths = np.fmin(ranges if rays is None else ranges.take(rays), reach)
    if lengths.size:
        scene.run(np.broadcast_to(origins, directions.shape).T, directions.T, lengths, query="DISTANCE")
    ranges[slice(None) if rays is None else rays] = np.where(lengths < reach, lengths, np.float32(np.nan))


def _turned(directions: np.ndarray, angular_velocity: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Turns directions ``[3, R]`` by ``angular_velocity [3]`` times the firing ``times [R]``."""
    speed = np.linalg.norm(angular_velocity)
    return turn_about(directions, angular_velocity / np.maximum(speed, 1e-12), speed * times)


def _checked(name: str, values: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """Returns ``values`` as float64 after checking them against ``shape``, where -1 stands for any length."""
    if values is None:
        raise ValueError(f"{name} is needed for motion distortion, got None.")
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != len(shape) or any(want not in (-1, have) for want, have in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name} must have shape {list(shape)} (-1: any length), got {list(array.shape)}.")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got NaN or infinite values.")
    return array


def _checked_rotations(values: np.ndarray, count: int) -> np.ndarray:
    """Returns ``count`` rotation matrices ``[N, 3, 3]`` as float64 after checking them."""
    rotations = _checked("rotations", values, (count, 3, 3))
    if np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0) > 1e-3:
        raise ValueError("rotations must be rotation matrices, got one whose rows are not orthonormal.")
    return rotations
