"""A map for each of several vehicles: the first guard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from uavrl_onboard.geometry import heading_vector
from uavrl_onboard.guards.map.goal_finder import GoalFinder
from uavrl_onboard.guards.map.navigator import Navigator
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.vehicle import VEHICLE, Vehicle


class Wayfinder:
    """Leads N vehicles along the quickest ways through what each has seen since its episode began.

    Each has a :class:`Navigator`. Where places and goals are unknown, as in training, a vehicle knows its place since
    the episode's start by its own velocity, integrated from scan to scan, and the goal is where its directions from
    different places meet (:class:`GoalFinder`).

    Args:
        vehicles: N.
        sight: how far returns count, m.
        reach: m from the vehicle, beyond which its map forgets.
        flight_level: m, the altitude of the map.
        cell: edge of the map's cells, m.
        period: time between two scans, s.
        sensor_position: of the LiDAR in body axes, m.

    Examples:
        A wall of 4 m stands 2 m ahead, a little to the left: the way leads past its right end.

        >>> side = np.linspace(-1.0, 3.0, 40)
        >>> wall = np.stack(np.broadcast_arrays(2.0, side, -0.1), -1)[None]
        >>> finder = Wayfinder(1)
        >>> still, altitude, ahead = np.zeros((1, 3)), np.array([3.5]), np.zeros(1)
        >>> turn = finder.lead(Situation(wall, still, still, altitude, ahead))
        >>> bool(-1.2 < turn[0] < -0.4)
        True
    """

    def __init__(
        self,
        vehicles: int,
        sight: float = 12.0,
        reach: float = 40.0,
        flight_level: float = VEHICLE.flight_level,
        cell: float = 0.25,
        period: float = VEHICLE.period,
        sensor_position: Sequence[float] = VEHICLE.lidar_position,
    ) -> None:
        self.sight, self.reach, self.period = sight, reach, period
        about = (sight, reach, flight_level, cell, sensor_position, period)
        self.navigators = [Navigator(*about) for _ in range(vehicles)]
        self._goals = [GoalFinder(reach) for _ in range(vehicles)]
        self._begun = np.zeros(vehicles, bool)  # whether it has had a scan in this episode
        self._places, self._velocities = np.zeros((2, vehicles, 3))

    @classmethod
    def of(cls, vehicle: Vehicle, vehicles: int, sight: float) -> Wayfinder:
        """Return one for vehicles of this kind."""
        return cls(
            vehicles,
            sight,
            flight_level=vehicle.flight_level,
            period=vehicle.period,
            sensor_position=vehicle.lidar_position,
        )

    def reset(self, which: np.ndarray) -> None:
        """Forgets all that some vehicles have seen, ``bool [N]``; their next scan is their first."""
        for one in np.flatnonzero(which).tolist():
            self.navigators[one].reset()
            self._goals[one] = GoalFinder(self.reach)
        self._begun[which], self._places[which] = False, 0.0

    @property
    def detours(self) -> np.ndarray:
        """By how many metres the last ways count more than ways in free air, ``[N]``; 0 where there is none."""
        return np.array([navigator.known.detour for navigator in self.navigators])

    def lead(self, seen: Situation) -> np.ndarray:
        """Take in scans without what moves; return how far off the goals' directions the ways lead, ``[N]`` rad.

        It is 0 where the way leads straight on to the goal, where the map leaves none, for a vehicle without a new
        scan, and for one whose pose or velocity is not finite: it has not looked then, and its place stays where it
        was.
        """
        clouds = [partial(seen.standing, one, self.sight) for one in range(len(seen.clouds))]
        if seen.places is None or seen.goals is None:
            return self._find(seen, clouds)
        rows = zip(self.navigators, clouds, seen.attitudes, seen.places, seen.goals, seen.bodies, strict=True)
        return np.array([navigator.lead(*row) for navigator, *row in rows])

    def filter(self, velocities: np.ndarray, seen: Situation) -> np.ndarray:
        """Return the velocities as they are: a map changes headings."""
        return velocities

    def _find(self, seen: Situation, clouds: Sequence[Callable[[], np.ndarray]]) -> np.ndarray:
        """The turns ``[N]`` in rad where places and goals are found out; scans are asked for only where needed."""
        which = np.ones(len(self._begun), bool) if seen.which is None else seen.which
        state = np.column_stack([seen.velocities, seen.attitudes, seen.altitudes, seen.headings])
        which = which & np.isfinite(state).all(1)
        flown = np.where(self._begun[:, None], self.period * (seen.velocities + self._velocities) / 2, 0.0)
        self._places[which] += flown[which]
        self._velocities[which], self._begun[which] = seen.velocities[which], True
        turns, bearings = np.zeros(len(which)), seen.attitudes[:, 2] + seen.headings
        for one in np.flatnonzero(which).tolist():
            place = self._places[one, :2]
            goal = self._goals[one].look(place, heading_vector(bearings[one]))
            at = np.append(place, seen.altitudes[one])
            turns[one] = self.navigators[one].lead(clouds[one], seen.attitudes[one], at, goal, seen.bodies[one])
        return turns
