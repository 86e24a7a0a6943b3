"""What flying somewhere costs where something else will pass, and what to fly instead.

The functions take arrays of numpy, for one vehicle that flies, and tensors of PyTorch, for many that are simulated.
"""

import numpy as np

from uavrl.arrays import Array, library_of, like
from uavrl.attitude import body_to_world
from uavrl.errors import UavrlError
from uavrl.hull import HULL, Hull, hull_distances, off_altitudes
from uavrl.motion.histogram import polar_histogram
from uavrl.motion.occlusion import find_returns
from uavrl.motion.rays import far_rays
from uavrl.motion.sight import MotionSight
from uavrl.motion.threats import DIRECTIONS, greatest_threats, predict_path, straight_on, to_yaw

SPEED = 2.0  # m/s, of what is flown in place of a planned velocity
SHARES = np.array([1.0, 0.5, 0.0], np.float32)  # of the speed that a direction would be flown at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand
NEAR, FAR = 0.15, 0.6  # m between hull and obstacle: a collision, and where it begins to cost, by hand, too
SOON = 10  # steps of 0.1 s in which that is looked for
STANDING = 4.0  # m, how far obstacles count in that
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
    library = library_of(planned)
    worst = greatest_threats(planned, velocity, ways, known)
    flown = planned + 0.0
    for one in library.where(worst > 0)[0].tolist():
        own = slice(one, one + 1)
        tried = library.concatenate([planned[own], like(OTHERS * np.float32(limit / SPEED), planned)])[
            None
        ]  # [1, C, 3]
        path = predict_path(tried, velocity[own, None])[0, :, :SOON]  # [C, T, 3]
        beside = hull_distances(points[one], path, NEAR, hull)
        off = library.amax(off_altitudes(height[one] + path[..., 2]), -1)
        near = library.amax(((FAR - beside) / (FAR - NEAR)).clip(0.0, 1.0), -1)
        threats = greatest_threats(tried, velocity[own], ways[own], known[own])[0]
        changed = ((tried[0] - planned[one]) ** 2).sum(-1) ** 0.5 / limit
        cost = changed + THREAT * (threats + near + (beside < NEAR).any(-1)) + OUTSIDE * off
        flown[one] = tried[0, cost.argmin()]
    return flown


class Evasion:
    """Keeps vehicles out of the ways of what moves, whatever they are asked to fly.

    :class:`~uavrl.motion.MotionSight` finds what moves in their scans. Where a velocity that is asked for leads to it
    within two seconds, if it flies straight on, :func:`evaded` chooses another one, off what stands.

    Args:
        vehicles: N.
        max_range: how far moving objects are looked for, m; the scans must reach as far.
        objects: of each vehicle, the nearest, that count.
        hull: its radius, and half its height, m.
        sensor: m, of the LiDAR over the hull's middle.
        limit: greatest component of what may be flown, m/s, and the speed of what is flown instead.
        period: time between two scans, s.

    Examples:
        A ball of 0.3 m comes at 3 m/s, straight ahead, to a vehicle that stands; asked to fly on, it gives way:

        >>> evasion, ring = Evasion(), np.linspace(-0.15, 0.15, 5)
        >>> ball = np.stack(np.broadcast_arrays(8.0, ring[:, None], ring), -1).reshape(1, -1, 3)
        >>> asked, still = np.array([[2.0, 0.0, 0.0]]), np.zeros((1, 3))
        >>> for step in range(10):
        ...     found = evasion(asked, ball - [0.3 * step, 0.0, 0.0], still, still, np.zeros(1))
        >>> bool(np.linalg.norm(found[0, 1:]) > 0.5)
        True
    """

    def __init__(
        self,
        vehicles: int = 1,
        max_range: float = 12.0,
        objects: int = 3,
        *,
        hull: Hull = HULL,
        sensor: float = 0.1,
        limit: float = SPEED,
        period: float = 0.1,
    ) -> None:
        self.vehicles, self.max_range = vehicles, max_range
        self.hull, self.sensor, self.limit = hull, sensor, limit
        self._sight = MotionSight(vehicles, max_range, objects, period)

    def reset(self, which: np.ndarray | None = None) -> None:
        """Forgets what some vehicles have seen, ``bool [N]``, or all."""
        self._sight.reset(np.ones(self.vehicles, bool) if which is None else which)

    def __call__(
        self,
        asked: np.ndarray,
        clouds: np.ndarray,
        velocities: np.ndarray,
        attitudes: np.ndarray,
        heights: np.ndarray,
        elapsed: float | None = None,
    ) -> np.ndarray:
        """Takes in another scan, and gives the velocities ``[N, 3]`` to fly in place of those that are asked for.

        Args:
            asked: ``[N, 3]``, forward, left and up, m/s in the axes of the yaw, as those that are given.
            clouds: ``[N, P, 3]`` in m in the sensor frame, in any order; NaN, infinity and zeros are misses.
            velocities: ``[N, 3]``, of the vehicles in world axes in m/s.
            attitudes: ``[N, 3]``, their roll, pitch and yaw in rad.
            heights: ``[N]``, over the flight level, m.
            elapsed: since the scans before, s. None: ``period``.

        Raises:
            UavrlError: for velocities, angles, heights and times that are not finite.
        """
        asked = np.asarray(asked, float).clip(-self.limit, self.limit)  # what is flown of it
        velocities, attitudes, heights = (np.asarray(each, float) for each in (velocities, attitudes, heights))
        if elapsed is not None and not 0.0 < elapsed < np.inf:
            raise UavrlError(f"elapsed must be a finite time above 0 s, got {elapsed}: give that between two scans.")
        if not all(np.isfinite(each).all() for each in (asked, velocities, attitudes, heights)):
            raise UavrlError(
                f"To keep out of the way of what moves takes finite numbers, got {asked} m/s asked for, velocities "
                f"{velocities}, roll, pitch and yaw {attitudes} rad and heights {heights} m."
            )
        if not self.vehicles:
            return asked
        objects = self._sight.look(_thinned(clouds), velocities, attitudes, elapsed=elapsed)
        ways, known = straight_on(objects.reshape(len(objects), -1).astype(float))
        tilts = body_to_world(attitudes * [1.0, 1.0, 0.0])
        above = self.sensor * tilts[:, :, 2]
        ways, own = ways + above[:, None, None], to_yaw(velocities, attitudes[:, 2])
        threatened = np.flatnonzero(greatest_threats(asked, own, ways, known) > 0)
        flown = asked.copy()
        for one in threatened:
            mine, points = slice(one, one + 1), find_returns(clouds[one, None], STANDING).points
            around = polar_histogram((tilts[one] @ points).T + above[one], np.zeros(points.shape[1], int), 1)
            told = asked[mine], own[mine], ways[mine], known[mine], around, heights[mine, None]
            flown[mine] = evaded(*told, self.hull, self.limit)
        return flown


def _thinned(clouds: np.ndarray) -> np.ndarray:
    """Of each scan ``[N, P, 3]`` the rays that look for what moves, ``[N, Q, 3]``, NaN where one has fewer."""
    rays = [far_rays(cloud) for cloud in clouds]
    found = np.full((len(rays), max(map(len, rays), default=0), 3), np.nan, clouds.dtype)
    for one, each in enumerate(rays):
        found[one, : len(each)] = each
    return found
