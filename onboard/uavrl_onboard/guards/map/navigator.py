"""One vehicle's map, fed with its scans, and how far off the goal's direction the way through it leads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from uavrl_onboard.geometry import body_to_world, is_return, within, yaw_to_world
from uavrl_onboard.guards.map.episode_map import EpisodeMap
from uavrl_onboard.guards.map.route import waypoint
from uavrl_onboard.vehicle import VEHICLE, lidar_place

CELL, REACH = 0.25, 40.0  # m: edge of the map's cells, and from the vehicle to where they are forgotten
LEVEL = 0.4  # m over and under the flight level, within which what is seen is in the way
ELSEWHERE = 2.0  # m between two scans, after which the map is no longer of where the vehicle is
EVERY = 5  # of so many scans one is entered, and then the way is found anew: 2 Hz of 10
AHEAD = 4.0  # m, how far along the way a vehicle looks
ROUGH = 1e-4  # share of the sight by which heights in single precision may be off, and more
BESIDE = 0.5  # m around a moving body, in which the cells that it left lie
CIRCLES, WITHIN = 6.0, 4.0  # s in which a vehicle that stays within so many m along each axis gets nowhere
FARTHEST = 1e8  # m from the origin, beyond which no vehicle is: cells are counted in 32 bits


class Navigator:
    """Leads a vehicle that knows its place and its goal along the quickest way through what it has seen.

    What every fifth scan shows at the flight level enters a map of cells, and the quickest way through it to the goal
    is found (:func:`uavrl_onboard.guards.map.route.route`), in which what was not seen is free. So a vehicle looks into
    a dead end and flies out again. Where the way bends around a corner, it leads to a point behind the corner, which a
    policy that avoids obstacles flies around by itself; where the vehicle has got nowhere for some seconds, it leads to
    the last point before the corner. Moving objects leave the map again where they are told; what lies over or under
    the flight level is not in it. A vehicle that is 2 m elsewhere from one scan to the next begins a new map: its axes
    have moved.

    Args:
        sight: how far returns count, m.
        reach: m from the vehicle, 40 by default, beyond which its map forgets; of a goal that is farther it heads for
            the direction.
        flight_level: m, the altitude of the map.
        cell: edge of the map's cells, m; 0.25 by default.
        sensor_position: of the LiDAR in body axes, m.
        period: time between two scans, s.

    Raises:
        ValueError: for a ``sensor_position`` that is not three finite numbers.

    Examples:
        A wall of 4 m stands 2 m ahead, a little to the left: the way leads past its right end.

        >>> side = np.linspace(-1.0, 3.0, 40)
        >>> wall = np.stack(np.broadcast_arrays(2.0, side, -0.1), -1)
        >>> navigator, level = Navigator(), np.zeros(3)
        >>> turn = navigator.look(wall, level, place=np.array([0.0, 0.0, 3.5]), goal=np.array([15.0, 0.0]))
        >>> -1.2 < turn < -0.4
        True
    """

    def __init__(
        self,
        sight: float = 12.0,
        reach: float = REACH,
        flight_level: float = VEHICLE.flight_level,
        cell: float = CELL,
        sensor_position: Sequence[float] = VEHICLE.lidar_position,
        period: float = VEHICLE.period,
    ) -> None:
        self.period = period
        self.sight, self.flight_level, self.sensor_position = sight, flight_level, lidar_place(sensor_position)
        self._size = (cell, reach)
        self.reset()
        self.known.route(np.zeros(2), np.zeros(2))  # which loads SciPy: that takes longer than a vehicle can wait

    def reset(self) -> None:
        """Forgets all that was seen."""
        self.known = EpisodeMap(*self._size)
        self._way: np.ndarray | None = None
        self._trail: deque[np.ndarray] = deque(maxlen=max(round(CIRCLES / self.period), 2))  # places, the last one last
        self._scans = 0

    def look(
        self,
        cloud: np.ndarray,
        attitude: np.ndarray,
        place: np.ndarray,
        goal: np.ndarray,
        bodies: np.ndarray | None = None,
    ) -> float:
        """Takes in another scan; returns how far off the goal's direction the way leads, in [-π, π] rad.

        It is left positive, and 0 where the way leads straight on to the goal, where the map leaves none, and where
        attitude or place is not finite, or the place is no vehicle's (over 1e8 m): then nothing was looked at.

        Args:
            cloud: ``[P, 3]`` in m in the sensor frame; NaN, inf or zeros where a ray hit nothing.
            attitude: ``[3]``, the vehicle's roll, pitch and yaw in rad.
            place: ``[3]``, of the vehicle in m, in axes whose z is the altitude.
            goal: ``[2]`` m, in the same axes.
            bodies: ``[M, 7]``, moving objects as
                ``MotionSight`` reports them. Their points are not in ``cloud``;
                cells that they left before they were known to move are forgotten.
        """
        return self.lead(lambda: cloud[is_return(cloud, within(self.sight))], attitude, place, goal, bodies)

    def lead(
        self,
        returns: Callable[[], np.ndarray],
        attitude: np.ndarray,
        place: np.ndarray,
        goal: np.ndarray,
        bodies: np.ndarray | None = None,
    ) -> float:
        """Do what :meth:`look` does; ask for the returns within sight only where they are entered into the map."""
        if not np.isfinite([*attitude, *place]).all() or np.abs(place).max() > FARTHEST:
            return 0.0
        level = np.array(place[:2], np.float64)  # its own: a caller may move its place on in the same array
        if (far := float(np.linalg.norm(goal - level))) > (reach := self._size[1]):
            goal = level + reach / far * (goal - level)  # beyond it nothing is known, and the search would take seconds
        if self._trail and np.linalg.norm(level - self._trail[-1]) > ELSEWHERE:
            self.reset()
        due, now = self._scans % EVERY == 0, self._scans * self.period
        self._scans += 1
        self._trail.append(level)
        if due:
            self.known.look(self._seen(returns(), attitude, place[2]) + level, level, now)
        if bodies is not None and len(bodies):
            ways = yaw_to_world(np.stack([bodies[:, :2], bodies[:, 3:5]], 1), float(attitude[2]))
            for (there, velocity), size in zip(ways, bodies[:, 6], strict=True):
                self.known.forget(level + there, velocity, size / 2 + BESIDE, now)
        if due:
            self._way = self.known.route(level, goal)
        if self._way is None:
            return 0.0
        point, straight = waypoint(self._way, level, self.known.middles(), AHEAD, closely=self._circles())
        if straight and point == len(self._way) - 1:
            return 0.0
        (x, y), (goal_x, goal_y) = self._way[point] - level, goal - level
        return float((np.arctan2(y, x) - np.arctan2(goal_y, goal_x) + np.pi) % (2 * np.pi) - np.pi)

    def _circles(self) -> bool:
        """Whether the vehicle has got nowhere for a while."""
        return len(self._trail) == self._trail.maxlen and bool((np.ptp(self._trail, axis=0) < WITHIN).all())

    def _seen(self, returns: np.ndarray, attitude: np.ndarray, altitude: float) -> np.ndarray:
        """What returns within sight show at the flight level, ``[K, 2]`` m from the vehicle, world axes."""
        rotation = body_to_world(attitude[None])[0]
        above = rotation @ np.array(self.sensor_position)
        rough = returns @ rotation[2].astype(returns.dtype) + (above[2] + altitude - self.flight_level)
        points = returns.take(np.flatnonzero(np.abs(rough) < LEVEL + ROUGH * self.sight), axis=0) @ rotation.T + above
        return points[np.abs(points[:, 2] + altitude - self.flight_level) < LEVEL, :2]
