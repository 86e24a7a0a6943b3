"""Rotations, and how near a vehicle's hull comes to what is around it."""

import numpy as np

from uavrl_onboard.arrays import Array, library_of, like

LOWEST, HIGHEST = -2.3, 0.7  # m from the flight level, between which one may fly

Hull = tuple[float, float]  # m: the radius, and half the height
HULL: Hull = (0.35, 0.14)


def stretch(near: float, hull: Hull = HULL) -> np.ndarray:
    """Factors ``[3]`` by which the flat hull, with ``near`` metres kept all around it, becomes as high as wide.

    Examples:
        >>> round(float((0.14 + 0.15) * stretch(0.15)[2]), 3)  # the hull's radius, and 0.15 m
        0.5
    """
    return np.array([1.0, 1.0, (hull[0] + near) / (hull[1] + near)], np.float32)


def hull_distances(points: Array, places: Array, near: float, hull: Hull = HULL) -> Array:
    """How far the hull is from its nearest obstacle ``[*B]`` m at ``places [*B, 3]``, of ``points [P, 3]``.

    Heights are stretched until the hull, with ``near`` metres around it, is as high as wide.

    Examples:
        >>> hull_distances(np.array([[1.35, 0.0, 0.0]]), np.zeros((1, 3)), 0.15).round(6).tolist()
        [1.0]
    """
    library = library_of(places)
    if not len(points):
        return library.full_like(places[..., 0], np.inf)
    factors = like(stretch(near, hull), places)
    points, flat = points * factors, (places * factors).reshape(-1, 3)
    apart = (-2.0 * flat) @ points.T + (points * points).sum(-1)
    least = library.amin(apart, -1) + (flat * flat).sum(-1)
    return (library.sqrt(least.clip(0.0)) - hull[0]).reshape(places.shape[:-1])


def inside(points: np.ndarray, hull: Hull = HULL) -> np.ndarray:
    """Which of ``points [P, 3]``, m from the hull's middle in body axes, are of the vehicle itself: ``bool [P]``.

    Examples:
        >>> inside(np.array([[0.3, 0.0, 0.1], [0.3, 0.0, 0.2]])).tolist()
        [True, False]
    """
    return (np.hypot(points[:, 0], points[:, 1]) < hull[0]) & (np.abs(points[:, 2]) < hull[1])


def off_altitudes(off: Array) -> Array:
    """How far heights ``off`` the flight level, in m, lie out of where one may fly: below the ceiling, off the ground.

    Examples:
        >>> off_altitudes(np.array([0.0, 1.0, -3.0])).round(3).tolist()
        [0.0, 0.3, 0.7]
    """
    return (LOWEST - off).clip(0.0) + (off - HIGHEST).clip(0.0)


def body_to_world(attitudes: np.ndarray) -> np.ndarray:
    """Rotations ``[N, 3, 3]`` of roll, pitch and yaw ``[N, 3]`` in rad: yaw about z, then pitch, then roll.

    Examples:
        >>> (body_to_world(np.array([[0.0, 0.0, np.pi / 2]]))[0] @ [1.0, 0.0, 0.0]).round(9).tolist()
        [0.0, 1.0, 0.0]
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitudes).T, np.sin(attitudes).T
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def body_to_level(attitudes: np.ndarray) -> np.ndarray:
    """Rotations ``[N, 3, 3]`` of the same into axes that are level and point where the yaw does.

    Examples:
        >>> (body_to_level(np.array([[0.0, 0.0, 2.0]]))[0] @ [1.0, 0.0, 0.0]).tolist()
        [1.0, 0.0, 0.0]
    """
    return body_to_world(attitudes * [1.0, 1.0, 0.0])
