"""The costs of flying where moving objects will pass, and the velocity to fly instead."""

from collections.abc import Callable
from functools import partial

import numpy as np

from uavrl_onboard.geometry import hull_distances, off_altitudes
from uavrl_onboard.perception.motion.threats import greatest_threats, nearness, predict_path, straight_on
from uavrl_onboard.vehicle import VEHICLE, Vehicle

SHARES = np.array([1.0, 0.5, 0.0], np.float32)  # of the speed that a direction would be flown at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand
# What another velocity costs, chosen by hand; a change by the velocity limit costs 1.
MEETING_COST, NEAR_COST, HIT_COST = 10.0, 3.0, 10.0  # of a moving body, and of obstacles beside and in the way
OUTSIDE_COST = 10.0  # of a metre beyond the altitudes in which one may fly
LASTING = 3.0  # weight of the mean nearness to moving bodies beside its greatest
NEAR, FAR = 0.15, 0.6  # m between hull and obstacle: a collision, and where it begins to cost
OBSTACLE_STEPS = 10  # of 0.1 s, in which obstacles and altitudes count
BLOCKS = 10  # in which velocities are looked at, the cheapest first
STEEP = 0.7  # m/s up or down, from which a body is taken to climb or dive
RISES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0], np.float32)  # upward velocities to fly instead, as shares of the limit


def _others() -> np.ndarray:
    """Velocities to fly instead, as shares of the limit ``[C, 3]``: 24 directions, half and full speed; all rises."""
    azimuths = np.linspace(-np.pi, np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(azimuths), np.sin(azimuths)], -1)
    level = np.concatenate([circle, 0.5 * circle, np.zeros((1, 2))])
    rises = np.repeat(RISES, len(level))
    return np.column_stack([np.tile(level, (len(RISES), 1)), rises]).astype(np.float32)


OTHERS = _others()
CHOICES = len(RISES) + len(OTHERS)
"""How many velocities there are to fly instead, which are the planned one with other rises, and ``OTHERS``."""


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


def risks(paths: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """How near each of C paths ``[C, T, 3]`` comes to any of K bodies on their ways ``[K, T, 3]``, ``[C]``; 0 is far.

    Where all paths come too near, it still tells the better from the worse.

    Examples:
        A body comes straight ahead. To rise is better than to fly on, and to rise faster is better still:

        >>> way = np.stack([6 - 0.3 * np.arange(1, 21), np.zeros(20), np.zeros(20)], -1)[None]
        >>> rising = np.array([[2.0, 0.0, 0.0], [2.0, 0.0, 0.4], [2.0, 0.0, 2.0]])
        >>> on, slowly, fast = risks(predict_path(rising, np.array([2.0, 0.0, 0.0])), way)
        >>> bool(on > slowly > fast == 0)
        True
    """
    if not len(ways):
        return np.zeros(len(paths))
    near = nearness(paths[:, None] - ways).max(1)
    return np.asarray(near.max(-1) + LASTING * near.mean(-1))


def possible_ways(objects: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where moving objects ``[N, K, 7]`` may be in the next two seconds, and which of these ways there are.

    Each may fly straight on; one that climbs or dives may also level off at once.

    Returns:
        The ways ``[N, 2 * K, T, 3]`` in m, seen from the vehicles, and ``bool [N, 2 * K]``.

    Examples:
        >>> falling = np.array([[[4.0, 0.0, 2.0, -3.0, 0.0, -2.0, 0.5]]])
        >>> ways, known = possible_ways(falling)
        >>> ways[0, :, 9].round(1).tolist(), known.tolist()
        ([[1.0, 0.0, 0.0], [1.0, 0.0, 2.0]], [[True, True]])
    """
    level = objects.copy()
    level[..., 5] = 0.0
    level[np.abs(objects[..., 5]) < STEEP] = 0.0
    return straight_on(np.concatenate([objects, level], -2).reshape(len(objects), -1))


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
    reactive law beside a planner.

    Args:
        planned: in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m: those of :func:`possible_ways`, or
            those of bodies that fly straight on.
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
    flown = planned + 0.0
    for one in np.flatnonzero(known.any(-1)).tolist():
        told = planned[one], velocity[one], ways[one, known[one]]
        flown[one] = evaded_by_one(*told, partial(points.__getitem__, one), float(height[one, 0]), vehicle)
    return flown


def evaded_by_one(
    planned: np.ndarray,
    velocity: np.ndarray,
    ways: np.ndarray,
    points: Callable[[], np.ndarray],
    height: float,
    vehicle: Vehicle,
) -> np.ndarray:
    """:func:`evaded` for one vehicle; it asks for the obstacles around it only if it would meet a body."""
    if risks(predict_path(planned[None], velocity), ways)[0] <= 0:
        return planned
    around, limit = points(), vehicle.velocity_limit
    rising = np.column_stack([np.tile(planned[:2], (len(RISES), 1)), limit * RISES])
    tried = np.concatenate([planned[None], rising, limit * OTHERS])  # [C, 3]
    paths = predict_path(tried, velocity)  # [C, T, 3]
    cost = np.linalg.norm(tried - planned, axis=-1) / limit + MEETING_COST * risks(paths, ways)
    best, least = planned, np.inf
    for some in np.array_split(cost.argsort(kind="stable"), BLOCKS):
        if cost[some[0]] >= least:
            break
        total = cost[some] + standing_costs(paths[some, :OBSTACLE_STEPS], around, height, vehicle)
        if total.min() < least:
            best, least = tried[some[total.argmin()]], total.min()
    return best


def standing_costs(paths: np.ndarray, points: np.ndarray, height: float, vehicle: Vehicle) -> np.ndarray:
    """What C paths ``[C, T, 3]`` cost near obstacles and outside the altitudes in which one may fly, ``[C]``."""
    beside = hull_distances(points, paths, NEAR, vehicle.hull)
    close = ((FAR - beside) / (FAR - NEAR)).clip(0.0, 1.0).max(-1)
    off = off_altitudes(height + paths[..., 2], vehicle).max(-1)
    return np.asarray(NEAR_COST * close + HIT_COST * (beside < NEAR).any(-1) + OUTSIDE_COST * off)
