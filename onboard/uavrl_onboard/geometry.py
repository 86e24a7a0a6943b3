"""Rotations, returns of a scan, and distances between a vehicle's hull and obstacles: NumPy alone.

World axes are level with z up. Body axes are x forward, y left, z up. The axes of a yaw are level and point where the
vehicle's nose does. A quaternion is (w, x, y, z), except in :func:`rotations_of`, and turns from body axes to the
world's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from uavrl_onboard.vehicle import VEHICLE, Hull, Place, Vehicle

NEAREST_RETURN = 0.05  # m: inside the sensor's housing, where no return comes from; drivers write misses as zeros
Quaternion = tuple[float, float, float, float]
_UNIT = 0.01  # by which the squared length of a quaternion may differ from 1
# Products of quaternion entries (x, y, z, w), numbered 4 i + j, that add up to the entries of a rotation matrix.
_ROTATION_ENTRIES = (
    {0: 1, 5: -1, 10: -1, 15: 1}, {1: 2, 11: -2}, {2: 2, 7: 2},
    {1: 2, 11: 2}, {0: -1, 5: 1, 10: -1, 15: 1}, {6: 2, 3: -2},
    {2: 2, 7: -2}, {6: 2, 3: 2}, {0: -1, 5: -1, 10: 1, 15: 1},
)  # fmt: skip
_PRODUCTS = np.array([[float(terms.get(product, 0)) for terms in _ROTATION_ENTRIES] for product in range(16)])


def is_return(points: np.ndarray, squared_range: tuple[float, float] = (NEAREST_RETURN**2, np.inf)) -> np.ndarray:
    """Return which of ``points [*B, 3]`` are returns of the sensor: ``bool [*B]``.

    A miss is NaN, infinite, or within the sensor's housing, as the zeros are that some drivers write.

    Args:
        points: in m in the sensor frame.
        squared_range: squared distances in m² between which a return lies, both excluded.

    Examples:
        >>> points = np.array([[3.0, 0, 0], [0, 0, 0], [5.0, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]])
        >>> is_return(points).tolist(), is_return(points, (0.0025, 16.0)).tolist()
        ([True, False, True, False, False], [True, False, False, False, False])
    """
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    with np.errstate(over="ignore", invalid="ignore"):
        squared = x * x + y * y + z * z
        return (squared > squared_range[0]) & (squared < squared_range[1])


def within(farthest: float) -> tuple[float, float]:
    """Return the ``squared_range`` in m² of returns that are nearer than ``farthest`` metres.

    Examples:
        >>> within(4.0)[1]
        16.0
    """
    return NEAREST_RETURN**2, farthest**2


@dataclass(frozen=True, eq=False)
class Columns:
    """The returns of a scan, coordinate by coordinate, and the squares of their ranges.

    Several look at different parts of one scan. Misses are left out once for all, and each coordinate is in one piece,
    which NumPy runs through fastest.

    Examples:
        >>> scan = Columns.of(np.array([[3.0, 0, 0], [0, 0, 0], [5.0, 0, 0], [np.nan, 0, 0]]))
        >>> scan.squared.tolist(), scan.within(4.0).tolist(), scan.rows(scan.within(4.0)).tolist()
        ([9.0, 25.0], [0], [[3.0, 0.0, 0.0]])
    """

    points: np.ndarray  #: ``[3, M]`` in m in the sensor frame, in the scan's order
    squared: np.ndarray  #: ``[M]`` in m²

    @classmethod
    def of(cls, cloud: np.ndarray) -> Columns:
        """Return the columns of a scan ``[P, 3]``."""
        x, y, z = points = cloud.T if cloud.strides[0] == cloud.itemsize else np.ascontiguousarray(cloud.T)
        with np.errstate(over="ignore", invalid="ignore"):
            squared = x * x + y * y + z * z
            kept = np.flatnonzero((squared > NEAREST_RETURN**2) & (squared < np.inf))
        if len(kept) < len(squared):
            points, squared = np.stack([axis.take(kept) for axis in points]), squared.take(kept)
        return cls(points, squared)

    @cached_property
    def azimuths(self) -> np.ndarray:
        """Azimuths to the right of straight ahead, ``[M]`` in rad in [-π, π]."""
        return np.asarray(np.arctan2(-self.points[1], self.points[0]))

    def within(self, farthest: float) -> np.ndarray:
        """Return the places of the returns nearer than ``farthest`` metres, ``[K]``."""
        return self.between(within(farthest))

    def between(self, squared_range: tuple[float, float]) -> np.ndarray:
        """Return the places of the returns within some squares of ranges, ``[K]``, as :func:`is_return` does."""
        return np.flatnonzero((self.squared > squared_range[0]) & (self.squared < squared_range[1]))

    def rows(self, which: np.ndarray) -> np.ndarray:
        """Return the points at some places, ``[K, 3]``."""
        return np.ascontiguousarray(self.points.take(which, axis=1).T)


def first_least(cells: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return the place of the least value in each of ``count`` cells that has any, cell by cell; the first of equals.

    Args:
        cells: ``int [M]``, in which the values lie.
        values: ``[M]``, none NaN.
        count: of the cells.

    Examples:
        >>> first_least(np.array([2, 0, 2, 2]), np.array([5.0, 7.0, 3.0, 3.0]), 4).tolist()
        [1, 2]
    """
    least = np.full(count, np.inf, values.dtype)
    np.minimum.at(least, cells, values)
    reached = np.flatnonzero(values == least.take(cells))
    return reached.take(np.unique(cells.take(reached), return_index=True)[1])


def stretch(near: float, hull: Hull = VEHICLE.hull) -> np.ndarray:
    """Return the factors ``[3]`` that make the flat hull, with ``near`` metres kept all around it, as high as wide.

    Examples:
        >>> round(float((0.14 + 0.15) * stretch(0.15)[2]), 3)  # the hull's radius, and 0.15 m
        0.5
    """
    return np.array([1.0, 1.0, (hull[0] + near) / (hull[1] + near)], np.float32)


def hull_distances(points: np.ndarray, places: np.ndarray, near: float, hull: Hull = VEHICLE.hull) -> np.ndarray:
    """Return how far the hull at ``places [*B, 3]`` is from the nearest of ``points [P, 3]``, ``[*B]`` in m.

    Heights are stretched until the hull, with ``near`` metres around it, is as high as wide.

    Examples:
        >>> hull_distances(np.array([[1.35, 0.0, 0.0]]), np.zeros((1, 3)), 0.15).round(6).tolist()
        [1.0]
    """
    if not len(points):
        return np.full_like(places[..., 0], np.inf)
    factors = stretch(near, hull)
    points, flat = points * factors, (places * factors).reshape(-1, 3)
    apart = (-2.0 * flat) @ points.T + (points * points).sum(-1)
    least = apart.min(-1) + (flat * flat).sum(-1)
    return np.asarray(np.sqrt(least.clip(0.0)) - hull[0]).reshape(places.shape[:-1])


def is_inside(points: np.ndarray, hull: Hull = VEHICLE.hull) -> np.ndarray:
    """Return which of ``points [P, 3]``, in m from the hull's middle in body axes, lie within the hull: ``bool [P]``.

    Examples:
        >>> is_inside(np.array([[0.3, 0.0, 0.1], [0.3, 0.0, 0.2]])).tolist()
        [True, False]
    """
    inside = np.abs(points[:, 2]) < hull[1]
    beside = np.flatnonzero(inside)
    inside[beside] = np.hypot(points[beside, 0], points[beside, 1]) < hull[0]
    return inside


def off_altitudes(off: np.ndarray, vehicle: Vehicle = VEHICLE) -> np.ndarray:
    """Return how far heights ``off`` the flight level lie outside the altitudes in which a vehicle may fly, in m.

    Examples:
        >>> off_altitudes(np.array([0.0, 1.0, -3.0])).round(3).tolist()
        [0.0, 0.3, 0.7]
    """
    return (vehicle.lowest - off).clip(0.0) + (off - vehicle.highest).clip(0.0)


def spherical(azimuth: np.ndarray, elevation: np.ndarray, distance: np.ndarray | float = 1.0) -> np.ndarray:
    """Return the points ``[*B, 3]`` at azimuths and elevations in rad, and distances in m; unit vectors by default.

    Args:
        azimuth: 0 ahead, positive to the left; of an angle that is measured clockwise, its negative.
        elevation: positive above the horizon.
        distance: from the origin.

    Examples:
        >>> spherical(np.radians([90.0, 0.0]), np.radians([0.0, 30.0]), 2.0).round(3).tolist()
        [[0.0, 2.0, 0.0], [1.732, 0.0, 1.0]]
    """
    across = distance * np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), distance * np.sin(elevation)], -1)


def world_to_yaw(vectors: np.ndarray, yaw: np.ndarray | float) -> np.ndarray:
    """Turn vectors from world axes into those of yaws in rad.

    Args:
        vectors: ``[N, *B, 2]`` or ``[N, *B, 3]``, whose z stays; ``[2]`` or ``[3]`` for one yaw.
        yaw: ``[N]``, or one number for all.

    Examples:
        >>> world_to_yaw(np.array([[0.0, 2.0, 1.0]]), np.array([np.pi / 2])).round(3).tolist()
        [[2.0, 0.0, 1.0]]
    """
    x, y, cos, sin = _level_parts(vectors, yaw)
    return np.stack([cos * x + sin * y, cos * y - sin * x, *np.moveaxis(vectors[..., 2:], -1, 0)], -1)


def yaw_to_world(vectors: np.ndarray, yaw: np.ndarray | float) -> np.ndarray:
    """Turn vectors from the axes of yaws in rad into world axes, the reverse of :func:`world_to_yaw`.

    Examples:
        >>> yaw_to_world(np.array([2.0, 0.0, 1.0]), np.pi / 2).round(3).tolist()
        [0.0, 2.0, 1.0]
    """
    x, y, cos, sin = _level_parts(vectors, yaw)
    return np.stack([cos * x - sin * y, sin * x + cos * y, *np.moveaxis(vectors[..., 2:], -1, 0)], -1)


def _level_parts(vectors: np.ndarray, yaw: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return x and y of vectors, and the cosine and sine of their yaws in a shape that fits them."""
    yaw = np.asarray(yaw)
    yaw = yaw.reshape(-1, *[1] * (vectors.ndim - 2)) if yaw.ndim else yaw
    return vectors[..., 0], vectors[..., 1], np.cos(yaw), np.sin(yaw)


def yaw_rotation(yaw: float) -> np.ndarray:
    """Return the rotation ``[3, 3]`` from the axes of a yaw in rad to the world's.

    Examples:
        >>> (yaw_rotation(np.pi / 2) @ [1.0, 0.0, 2.0]).round(9).tolist()
        [0.0, 1.0, 2.0]
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def heading_vector(yaw: float | np.ndarray) -> np.ndarray:
    """Return level unit vectors ``[*B, 2]`` that point where yaws ``[*B]`` in rad do.

    Examples:
        >>> heading_vector(np.pi).round(9).tolist()
        [-1.0, 0.0]
    """
    return np.stack([np.cos(yaw), np.sin(yaw)], -1)


def body_to_world(attitudes: np.ndarray) -> np.ndarray:
    """Return the rotations ``[N, 3, 3]`` of roll, pitch and yaw ``[N, 3]`` in rad: yaw about z, then pitch, then roll.

    Examples:
        >>> (body_to_world(np.array([[0.0, 0.0, np.pi / 2]]))[0] @ [1.0, 0.0, 0.0]).round(9).tolist()
        [0.0, 1.0, 0.0]
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitudes).T, np.sin(attitudes).T
    rotations = np.empty((*cr.shape, 3, 3), cr.dtype)
    rotations[..., 0, 0], rotations[..., 1, 0], rotations[..., 2, 0] = cy * cp, sy * cp, -sp
    rotations[..., 0, 1], rotations[..., 0, 2] = cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    rotations[..., 1, 1], rotations[..., 1, 2] = sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    rotations[..., 2, 1], rotations[..., 2, 2] = cp * sr, cp * cr
    return rotations


def body_to_level(attitudes: np.ndarray) -> np.ndarray:
    """Return the rotations ``[N, 3, 3]`` of roll, pitch and yaw ``[N, 3]`` in rad into the axes of the yaw.

    Examples:
        >>> (body_to_level(np.array([[0.0, 0.0, 2.0]]))[0] @ [1.0, 0.0, 0.0]).tolist()
        [1.0, 0.0, 0.0]
    """
    return body_to_world(attitudes * [1.0, 1.0, 0.0])


def attitude_of(rotation: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw ``[*B, 3]`` in rad of rotations ``[*B, 3, 3]``, the reverse of :func:`body_to_world`.

    Examples:
        >>> attitude_of(body_to_world(np.array([[0.1, -0.2, 3.0]]))).round(9).tolist()
        [[0.1, -0.2, 3.0]]
    """
    roll = np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2])
    pitch = -np.arcsin(rotation[..., 2, 0].clip(-1.0, 1.0))
    return np.stack([roll, pitch, np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])], -1)


def rotation_about(axes: np.ndarray, angles: np.ndarray | float) -> np.ndarray:
    """Return the rotations ``[*B, 3, 3]`` by ``angles [*B]`` in rad about unit vectors ``axes [*B, 3]``.

    Source: Rodrigues' formula, R = 1 + sin(a) K + (1 - cos(a)) K², where K v = axis x v.

    Examples:
        >>> (rotation_about(np.array([0.0, 0.0, 1.0]), np.pi / 2) @ [1.0, 0.0, 0.0]).round(9).tolist()
        [0.0, 1.0, 0.0]
    """
    angles = np.asarray(angles)[..., None, None]
    x, y, z = axes[..., 0], axes[..., 1], axes[..., 2]
    cross = np.zeros((*x.shape, 3, 3), axes.dtype)
    cross[..., 1, 0], cross[..., 0, 2], cross[..., 2, 1] = z, y, x
    cross[..., 0, 1], cross[..., 2, 0], cross[..., 1, 2] = -z, -y, -x
    return np.eye(3) + np.sin(angles) * cross + (1 - np.cos(angles)) * cross @ cross


def turn_about(vectors: np.ndarray, axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Turn ``vectors [3, M]``, each by one of ``angles [M]`` in rad, about one unit vector ``axis [3]``.

    It is :func:`rotation_about` for many angles, without a matrix for each.

    Examples:
        >>> turn_about(np.array([[1.0], [0.0], [2.0]]), np.array([0.0, 0.0, 1.0]), np.array([np.pi / 2])).round(9).T
        array([[0., 1., 2.]])
    """
    axis, cos, sin = axis[:, None], np.cos(angles), np.sin(angles)
    across, along = np.cross(axis, vectors, axis=0), (axis * vectors).sum(axis=0)
    return vectors * cos + across * sin + axis * (along * (1.0 - cos))


def quaternion(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the quaternion of roll, pitch and yaw in rad.

    Examples:
        >>> [round(each, 4) for each in quaternion(0.0, 0.0, math.pi / 2)]
        [0.7071, 0.0, 0.0, 0.7071]
    """
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(each / 2), math.sin(each / 2)) for each in (roll, pitch, yaw))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def roll_pitch_yaw(rotation: Sequence[float]) -> Place:
    """Return roll, pitch and yaw in rad of a quaternion; NaN if its length is not 1.

    Examples:
        >>> [round(each, 9) for each in roll_pitch_yaw(quaternion(0.1, -0.2, 3.0))]
        [0.1, -0.2, 3.0]
        >>> roll_pitch_yaw((0.0, 0.0, 0.0, 0.0))
        (nan, nan, nan)
    """
    w, x, y, z = rotation
    if not abs(w * w + x * x + y * y + z * z - 1.0) < _UNIT:
        return math.nan, math.nan, math.nan
    ahead, aside = 1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)  # where the nose points, seen from above
    yaw = math.atan2(aside, ahead)
    cos, sin = math.cos(yaw / 2), math.sin(yaw / 2)
    roll = 2.0 * math.atan2(cos * x + sin * y, cos * w + sin * z)  # without the yaw, so also straight down
    return math.remainder(roll, math.tau), math.atan2(2.0 * (w * y - x * z), math.hypot(ahead, aside)), yaw


def rotate(vector: Sequence[float], rotation: Sequence[float]) -> Place:
    """Turn one vector from body axes to the world's by a quaternion.

    Examples:
        >>> forward = rotate((1.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))  # by 90 degrees to the left
        >>> [round(abs(number), 9) for number in forward]
        [0.0, 1.0, 0.0]
    """
    w, axis, v = rotation[0], np.array(rotation[1:]), np.array(vector)
    across = 2.0 * np.cross(axis, v)
    x, y, z = (v + w * across + np.cross(axis, across)).tolist()
    return x, y, z


def rotations_of(quaternions: np.ndarray) -> np.ndarray:
    """Return the rotations ``[N, 3, 3]``, body to world, of unit quaternions ``[N, 4]`` in PyBullet's order x, y, z, w.

    Examples:
        >>> (rotations_of(np.array([[0.0, 0.0, 0.6, 0.8]]))[0] @ [1.0, 0.0, 0.0]).round(9).tolist()
        [0.28, 0.96, 0.0]
    """
    products = (quaternions[:, :, None] * quaternions[:, None, :]).reshape(-1, 16)
    return (products @ _PRODUCTS).reshape(-1, 3, 3)
