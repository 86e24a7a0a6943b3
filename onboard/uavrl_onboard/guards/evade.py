"""What flying somewhere costs where something else will pass, and what to fly instead.

The functions take arrays of numpy, for one vehicle that flies, and tensors of PyTorch, for many that are simulated.
"""

import numpy as np

from uavrl_onboard.arrays import Array, library_of, like
from uavrl_onboard.geometry import HULL, Hull, hull_distances, off_altitudes
from uavrl_onboard.perception.motion.threats import DIRECTIONS, greatest_threats, predict_path

SPEED = 2.0  # m/s, of what is flown in place of a planned velocity
SHARES = np.array([1.0, 0.5, 0.0], np.float32)  # of the speed that a direction would be flown at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand
NEAR, FAR = 0.15, 0.6  # m between hull and obstacle: a collision, and where it begins to cost, by hand, too
SOON = 10  # steps of 0.1 s in which that is looked for
OUTSIDE = 10.0  # cost of a metre beyond the altitudes in which one may fly
OTHERS = np.concatenate([*(SPEED * share * DIRECTIONS for share in SHARES[:-1]), np.zeros((1, 3), np.float32)])


def evade(
    cost: Array, speed: Array, directions: Array, velocity: Array, ways: Array, known: Array
) -> tuple[Array, Array]:
    """What each direction costs with the threats on it, and how fast it is then best flown: ``[N, D]`` each.

    Args:
        cost: of each direction without threats, ``[N, D]``.
        speed: at which each would be flown in m/s, likewise.
        directions: ``[D, 3]``, in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m.
        known: which of them there are, ``bool [N, K]``.
    """
    shares = like(SHARES, speed)
    commanded = speed[..., None, None] * shares[:, None] * directions[:, None]  # [N, D, S, 3]
    worst = greatest_threats(commanded, velocity, ways, known)
    total = cost[..., None] + SLOWNESS * (1 - shares) + THREAT * worst
    return library_of(total).amin(total, -1), shares[total.argmin(-1)] * speed


def evaded(
    planned: Array,
    velocity: Array,
    ways: Array,
    known: Array,
    points: list[Array],
    height: Array,
    hull: Hull = HULL,
    limit: float = SPEED,
) -> Array:
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
        hull: its radius, and half its height, m.
        limit: of the others' speed, m/s.

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
    library, others = library_of(planned), like(OTHERS * np.float32(limit / SPEED), planned)
    worst = greatest_threats(planned, velocity, ways, known)
    flown = planned + 0.0
    for one in library.where(worst > 0)[0].tolist():
        own = slice(one, one + 1)
        tried = library.concatenate([planned[own], others])[None]  # [1, C, 3]
        path = predict_path(tried, velocity[own, None])[0, :, :SOON]  # [C, T, 3]
        beside = hull_distances(points[one], path, NEAR, hull)
        off = library.amax(off_altitudes(height[one] + path[..., 2]), -1)
        near = library.amax(((FAR - beside) / (FAR - NEAR)).clip(0.0, 1.0), -1)
        threats = greatest_threats(tried, velocity[own], ways[own], known[own])[0]
        changed = ((tried[0] - planned[one]) ** 2).sum(-1) ** 0.5 / limit
        cost = changed + THREAT * (threats + near + (beside < NEAR).any(-1)) + OUTSIDE * off
        flown[one] = tried[0, cost.argmin()]
    return flown
