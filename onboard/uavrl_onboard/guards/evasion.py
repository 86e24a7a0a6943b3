"""Keeps vehicles out of the way of moving objects: the second guard."""

from __future__ import annotations

from functools import partial

import numpy as np

from uavrl_onboard.geometry import body_to_level, is_inside, world_to_yaw
from uavrl_onboard.guards.evade import evaded_by_one, possible_ways
from uavrl_onboard.guards.histogram import polar_histogram
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.perception.motion.occlusion import find_returns
from uavrl_onboard.vehicle import VEHICLE, Vehicle

STANDING = 4.0  # m, up to which obstacles that stand count


class Evasion:
    """Keeps vehicles out of the way of moving objects, whatever a policy asks for.

    Where a velocity would meet a moving object within two seconds, if that flies straight on or levels off,
    :func:`uavrl_onboard.guards.evade.evaded_by_one` chooses another velocity, away from obstacles that stand. Motion
    detection belongs to :class:`~uavrl_onboard.guards.chain.Guards`, which serves all guards.

    Args:
        vehicle: its hull, LiDAR, velocity limit and altitudes.

    Examples:
        A ball of 0.3 m comes at 3 m/s, straight ahead, to a vehicle that stands. Asked to fly on, it gives way:

        >>> from uavrl_onboard.guards.chain import Guards
        >>> from uavrl_onboard.guards.protocol import Situation
        >>> from uavrl_onboard.guards.settings import EvasionSettings, GuardSettings
        >>> guards, ring = Guards(GuardSettings(evasion=EvasionSettings())), np.linspace(-0.15, 0.15, 5)
        >>> ball = np.stack(np.broadcast_arrays(8.0, ring[:, None], ring), -1).reshape(1, -1, 3)
        >>> still, asked = (np.zeros((1, 3)), np.zeros((1, 3)), np.full(1, 3.5), np.zeros(1)), np.array([[2.0, 0, 0]])
        >>> for step in range(10):
        ...     _ = guards.lead(Situation(ball - [0.3 * step, 0.0, 0.0], *still))
        ...     flown = guards.filter(asked)
        >>> bool(np.linalg.norm(flown[0, 1:]) > 0.5)
        True
    """

    def __init__(self, vehicle: Vehicle = VEHICLE) -> None:
        self.vehicle = vehicle

    def reset(self, which: np.ndarray) -> None:
        """Do nothing: motion detection is reset by itself."""

    def lead(self, seen: Situation) -> None:
        """Return None: evasion changes no heading."""

    def filter(self, velocities: np.ndarray, seen: Situation) -> np.ndarray:
        """Return the velocities ``[N, 3]`` that avoid moving objects, in m/s: forward, left and up."""
        limit = self.vehicle.velocity_limit
        flown = np.asarray(velocities, float).clip(-limit, limit)
        if not seen.objects.any():
            return flown
        ways, known = possible_ways(seen.objects.astype(float))
        tilts, own = body_to_level(seen.attitudes), world_to_yaw(seen.velocities, seen.attitudes[:, 2])
        ways = ways + (self.vehicle.lidar_above * tilts[:, :, 2])[:, None, None]  # from the hull's middle
        heights = seen.altitudes - self.vehicle.flight_level
        for one in np.flatnonzero(known.any(1)).tolist():
            told = flown[one], own[one], ways[one, known[one]], partial(self._around, seen, one, tilts[one])
            flown[one] = evaded_by_one(*told, float(heights[one]), self.vehicle)
        return flown

    def _around(self, seen: Situation, vehicle: int, tilt: np.ndarray) -> np.ndarray:
        """The nearest return of each direction that is not of the vehicle itself, from its middle in level axes."""
        cloud = seen.standing(vehicle, STANDING)
        points = find_returns(cloud[None], STANDING).points.T + np.array([0.0, 0.0, self.vehicle.lidar_above])
        points = points[~is_inside(points, self.vehicle.hull)] @ tilt.T
        return polar_histogram(points, np.zeros(len(points), int), 1)[0]
