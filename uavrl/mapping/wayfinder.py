"""A map for each of several vehicles, fed with their scans, and the turns off the goal's direction that it asks for."""

from __future__ import annotations

import numpy as np

from uavrl.attitude import body_to_world
from uavrl.cells import NEAREST_RETURN
from uavrl.mapping.episode_map import EpisodeMap
from uavrl.mapping.route import waypoint

LIDAR_ABOVE = 0.1  # m, of the sensor over the hull's middle
LEVEL = 0.4  # m over and under the flight level, within which what is seen is in the way
EVERY = 5  # scans between two that are entered, after which the way is found anew: 2 Hz
AHEAD = 4.0  # m, how far along the way a vehicle looks


class Wayfinder:
    """Leads N vehicles along the quickest ways through what each has seen since its episode began.

    Each vehicle knows its place since the episode's start by its own velocity, integrated from scan to scan. Twice a
    second what a scan shows at the flight level enters a map of cells, and the quickest way through it to the goal is
    found (:func:`uavrl.mapping.route.route`), in which what was not seen is free. So a vehicle looks into a dead end
    and flies out again. The goal's distance is not told: the goal is where its directions from different places meet.

    What moves stays in the map where it was; what lies over or under the flight level is not in it.

    Args:
        vehicles: N.
        sight: how far returns count, m.
        reach: m from the vehicle, beyond which its map forgets.
        flight_level: m, the altitude of the map.
        cell: edge of the map's cells, m.
        period: time between two scans, s.

    Examples:
        A wall of 4 m stands 2 m ahead, a little to the left: the way leads past its right end.

        >>> side = np.linspace(-1.0, 3.0, 40)
        >>> wall = np.stack(np.broadcast_arrays(2.0, side, -0.1), -1)[None]
        >>> finder = Wayfinder(1)
        >>> still, altitude, ahead = np.zeros((1, 3)), np.array([3.5]), np.zeros(1)
        >>> turn = finder.look(wall, still, still, altitude, ahead)
        >>> bool(-1.2 < turn[0] < -0.4)
        True
    """

    def __init__(
        self,
        vehicles: int,
        sight: float = 12.0,
        reach: float = 40.0,
        flight_level: float = 3.5,
        cell: float = 0.25,
        period: float = 0.1,
    ) -> None:
        self.sight, self.reach, self.flight_level, self.cell, self.period = sight, reach, flight_level, cell, period
        self._maps = [EpisodeMap(cell, reach) for _ in range(vehicles)]
        self._ways: list[np.ndarray | None] = [None] * vehicles
        self._ages = np.zeros(vehicles, np.int64)  # scans since the episode began
        self._places, self._velocities = np.zeros((2, vehicles, 3))

    def reset(self, which: np.ndarray) -> None:
        """Forgets all that some vehicles have seen, ``bool [N]``; their next scan is their first."""
        for one in np.flatnonzero(which).tolist():
            self._maps[one], self._ways[one] = EpisodeMap(self.cell, self.reach), None
        self._ages[which], self._places[which] = 0, 0.0

    def look(
        self,
        clouds: np.ndarray,
        velocities: np.ndarray,
        attitudes: np.ndarray,
        altitudes: np.ndarray,
        headings: np.ndarray,
        which: np.ndarray | None = None,
    ) -> np.ndarray:
        """Takes in another scan and returns how far off the goal's direction the way leads: ``[N]`` rad, left positive.

        It is 0 where the way leads straight on to the goal, where the map leaves none, and for a vehicle whose pose or
        velocity is not finite: it has not looked then, and its place stays where it was.

        Args:
            clouds: ``[N, P, 3]`` in m in the sensor frame; NaN, inf or zeros where a ray hit nothing.
            velocities: ``[N, 3]``, of the vehicles in world axes in m/s.
            attitudes: ``[N, 3]``, their roll, pitch and yaw in rad.
            altitudes: ``[N]``, m.
            headings: ``[N]``, from each vehicle's head to its goal, left positive, rad.
            which: ``bool [N]``, which have a new scan; what is returned of the others is 0. None: all.
        """
        which = np.ones(len(self._ages), bool) if which is None else which
        which = which & np.isfinite(np.column_stack([velocities, attitudes, altitudes, headings])).all(1)
        flown = np.where((self._ages > 0)[:, None], self.period * (velocities + self._velocities) / 2, 0.0)
        self._places[which] += flown[which]
        self._velocities[which] = velocities[which]
        turns, rotations = np.zeros(len(which)), body_to_world(attitudes)
        for one in np.flatnonzero(which).tolist():
            due, place = self._ages[one] % EVERY == 0, self._places[one]
            points = self._seen(clouds[one], rotations[one], altitudes[one]) + place[:2] if due else np.zeros((0, 2))
            bearing = float(attitudes[one, 2] + headings[one])
            known = self._maps[one]
            known.look(points, place[:2], np.array([np.cos(bearing), np.sin(bearing)]))
            if due:
                self._ways[one] = known.route()
            turns[one] = self._turn(self._ways[one], place[:2], known, bearing)
        self._ages[which] += 1
        return turns

    def _seen(self, cloud: np.ndarray, rotation: np.ndarray, altitude: float) -> np.ndarray:
        """What a scan shows at the flight level, ``[K, 2]`` m from the vehicle, world axes."""
        with np.errstate(invalid="ignore", over="ignore"):
            squared = np.einsum("pi,pi->p", cloud, cloud)
            near = cloud[(squared > NEAREST_RETURN**2) & (squared < self.sight**2)]
        points = near @ rotation.T + LIDAR_ABOVE * rotation[:, 2]
        return points[np.abs(points[:, 2] + altitude - self.flight_level) < LEVEL, :2]

    def _turn(self, way: np.ndarray | None, place: np.ndarray, known: EpisodeMap, bearing: float) -> float:
        """From the goal's direction to that of the next waypoint, in [-π, π] rad."""
        if way is None:
            return 0.0
        point, straight = waypoint(way, place, known.middles(), AHEAD)
        if straight and point == len(way) - 1:
            return 0.0
        x, y = way[point] - place
        return float((np.arctan2(y, x) - bearing + np.pi) % (2 * np.pi) - np.pi)
