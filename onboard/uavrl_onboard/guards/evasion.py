"""Keeps vehicles out of the ways of what moves, by their scans: numpy alone."""

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import body_to_level, is_inside, world_to_yaw
from uavrl_onboard.guards.evade import evaded
from uavrl_onboard.guards.histogram import polar_histogram
from uavrl_onboard.perception.motion.occlusion import find_returns
from uavrl_onboard.perception.motion.rays import far_rays
from uavrl_onboard.perception.motion.sight import MotionSight
from uavrl_onboard.perception.motion.threats import greatest_threats, straight_on
from uavrl_onboard.vehicle import VEHICLE, Vehicle

STANDING = 4.0  # m, how far what stands counts


class Evasion:
    """Keeps vehicles out of the ways of what moves, whatever they are asked to fly.

    :class:`~uavrl.transforms.MotionSight` finds what moves in their scans. Where a velocity that is asked for leads to
    it within two seconds, if it flies straight on, :func:`uavrl_onboard.guards.evade.evaded` chooses another, off
    what stands.

    Args:
        vehicles: N.
        max_range: how far moving objects are looked for, m; the scans must reach as far.
        objects: of each vehicle, the nearest, that count.
        vehicle: its hull, LiDAR, velocity limit, control rate and altitudes.

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
        vehicle: Vehicle = VEHICLE,
    ) -> None:
        self.vehicles, self.max_range = vehicles, max_range
        self.vehicle = vehicle
        self._sight = MotionSight(vehicles, max_range, objects, vehicle.period)

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
            elapsed: since the scans before, s. None: the vehicle's period.

        Raises:
            UavrlError: for velocities, angles, heights and times that are not finite.
        """
        limit = self.vehicle.velocity_limit
        asked = np.asarray(asked, float).clip(-limit, limit)  # what is flown of it
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
        tilts, own = body_to_level(attitudes), world_to_yaw(velocities, attitudes[:, 2])
        ways = ways + (self.vehicle.lidar_above * tilts[:, :, 2])[:, None, None]  # from the hull's middle
        flown = asked.copy()
        for one in np.flatnonzero(greatest_threats(asked, own, ways, known) > 0):
            mine, around = slice(one, one + 1), self._around(clouds[one], tilts[one])
            told = asked[mine], own[mine], ways[mine], known[mine], around, heights[mine, None]
            flown[mine] = evaded(*told, self.vehicle)
        return flown

    def _around(self, cloud: np.ndarray, tilt: np.ndarray) -> list[np.ndarray]:
        """The nearest return of each direction that is not of the vehicle itself, from its middle in level axes."""
        points = find_returns(cloud[None], STANDING).points.T + np.array([0.0, 0.0, self.vehicle.lidar_above])
        points = points[~is_inside(points, self.vehicle.hull)] @ tilt.T
        return polar_histogram(points, np.zeros(len(points), int), 1)


def _thinned(clouds: np.ndarray) -> np.ndarray:
    """Of each scan ``[N, P, 3]`` the rays that look for what moves, ``[N, Q, 3]``, NaN where one has fewer."""
    rays = [far_rays(cloud) for cloud in clouds]
    found = np.full((len(rays), max(map(len, rays), default=0), 3), np.nan, clouds.dtype)
    for one, each in enumerate(rays):
        found[one, : len(each)] = each
    return found
