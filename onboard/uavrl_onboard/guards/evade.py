"""The costs of flying where moving objects will pass, and the velocity to fly instead."""

import numpy as np

from uavrl_onboard.geometry import hull_distances, off_altitudes
from uavrl_onboard.perception.motion.threats import DIRECTIONS, greatest_threats, predict_path
from uavrl_onboard.vehicle import VEHICLE, Vehicle

SHARES = np.array([1.0, 0.5, 0.0], np.float32)  # of the speed that a direction would be flown at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand
NEAR, FAR = 0.15, 0.6  # m between hull and obstacle: a collision, and where it begins to cost, by hand, too
SOON = 10  # steps of 0.1 s in which that is looked for
OUTSIDE = 10.0  # cost of a metre beyond the altitudes in which one may fly
# Velocities to fly instead, as shares of the limit.
OTHERS = np.concatenate([*(share * DIRECTIONS for share in SHARES[:-1]), np.zeros((1, 3), np.float32)])


def evade(
    cost: np.ndarray,
    speed: np.ndarray,
    directions: np.ndarray,
    velocity: np.ndarray,
    ways: np.ndarray,
    known: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """What each direction costs with the threats on it, and how fast it is then best flown: ``[N, D]`` each.

    Args:
        cost: of each direction without threats, ``[N, D]``.
        speed: at which each would be flown in m/s, likewise.
        directions: ``[D, 3]``, in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m.
        known: which of them there are, ``bool [N, K]``.
    """
    commanded = speed[..., None, None] * SHARES[:, None] * directions[:, None]  # [N, D, S, 3]
    worst = greatest_threats(commanded, velocity, ways, known)
    total = cost[..., None] + SLOWNESS * (1 - SHARES) + THREAT * worst
    return total.min(-1), SHARES[total.argmin(-1)] * speed


def evaded(
    planned: np.ndarray,
    velocity: np.ndarray,
    ways: np.ndarray,
    known: np.ndarray,
    points: list[np.ndarray],
    height: np.ndarray,
    vehicle: Vehicle = VEHICLE,
) -> np.ndarray:
    """Planned velocities ``[N, 3]`` in m/s, and in place of one that leads to a moving body the best of some others.

    Each other one costs its difference to the planned one, the moving bodies on it, and what stands near it. This is a
    reactive law beside a planner, for bodies that fly straight on.

    Args:
        planned: in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m.
        known: which of them there are, ``bool [N, K]``.
        points: of each vehicle the obstacles around it, ``[P, 3]`` m.
        height: of the vehicles over the flight level, ``[N, 1]`` m.
        vehicle: its hull, the altitudes in which it may fly, and its velocity limit, at which others are flown.

    Examples:
        A body comes straight ahead, at 3 m/s from 6 m away. The vehicle, which would fly at 2 m/s, gives way:

        >>> ahead = np.array([[2.0, 0.0, 0.0]])
        >>> ways = np.stack([6 - 0.3 * np.arange(1, 21), np.zeros(20), np.zeros(20)], -1)[None, None]
        >>> around = ([np.zeros((0, 3))], np.zeros((1, 1)))
        >>> bool(np.linalg.norm(evaded(ahead, ahead, ways, np.array([[True]]), *around)[0, 1:]) > 0.5)
        True
        >>> evaded(ahead, ahead, ways, np.array([[False]]), *around).tolist()
        [[2.0, 0.0, 0.0]]
    """
    limit, others = vehicle.velocity_limit, OTHERS * np.float32(vehicle.velocity_limit)
    worst = greatest_threats(planned, velocity, ways, known)
    flown = planned + 0.0
    for one in np.flatnonzero(worst > 0).tolist():
        own = slice(one, one + 1)
        tried = np.concatenate([planned[own], others])[None]  # [1, C, 3]
        path = predict_path(tried, velocity[own, None])[0, :, :SOON]  # [C, T, 3]
        beside = hull_distances(points[one], path, NEAR, vehicle.hull)
        off = off_altitudes(height[one] + path[..., 2], vehicle).max(-1)
        near = ((FAR - beside) / (FAR - NEAR)).clip(0.0, 1.0).max(-1)
        threats = greatest_threats(tried, velocity[own], ways[own], known[own])[0]
        changed = ((tried[0] - planned[one]) ** 2).sum(-1) ** 0.5 / limit
        cost = changed + THREAT * (threats + near + (beside < NEAR).any(-1)) + OUTSIDE * off
        flown[one] = tried[0, cost.argmin()]
    return flown
