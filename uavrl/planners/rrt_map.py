"""RRT-Connect on the last scans, led by a map of the whole episode: a planner that finds its way out of dead ends."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from uavrl.envs.limits import OrMapping
from uavrl.envs.quadrotor import Airframe
from uavrl.planners.point_memory import Surroundings
from uavrl.planners.rrt_connect import RRTConnect, RRTConnectWeights
from uavrl_onboard.geometry import yaw_rotation
from uavrl_onboard.guards.map import EpisodeMap, GoalFinder
from uavrl_onboard.guards.map.navigator import LEVEL
from uavrl_onboard.guards.map.route import waypoint
from uavrl_onboard.ranges import Positive, Seed
from uavrl_onboard.vehicle import VEHICLE


class RRTMap(RRTConnect):
    """:class:`~uavrl.planners.rrt_connect.RRTConnect`, led along a way to the goal through all that it has seen.

    Twice a second each vehicle enters what it remembers of its last scans into a map of its own, of cells at the flight
    level, which holds for the episode. The quickest way through the map (Dijkstra), in which what was not seen is free,
    leads to the goal; the planner below aims at a point of that way. So it looks into a dead end, and flies out again.
    It is told no distance to the goal: the goal is where its directions from different places meet.

    What lies over or under the flight level is left to the planner below. What moves stays in the map where it was.
    Where the map leaves no way, it acts as that planner does. In vehicles that are not as believed a wrong heading or
    velocity shifts the map and the goal.

    Args:
        flight_level: altitude to hold where nothing is in the way, m.
        radius: how far it sees, m; what lies farther is not used.
        seconds: for which the planner below remembers obstacles.
        motion: how far moving objects are looked for, as in :class:`uavrl.transforms.NavigationState`, to keep out of
            their ways; None: what moves is taken for standing.
        tries: times that a tree grows for a plan, at most.
        seed: of the plans.
        costs: None for those of :class:`~uavrl.planners.rrt_connect.RRTConnectWeights`.
        airframe: whose hull and LiDAR it reckons with; None for the default one.
        max_speed: limit of each component of the velocity, m/s.
        cell: edge of the map's cells, m.
        reach: m from the vehicle to each side, beyond which the map forgets.

    Raises:
        UavrlError: where OMPL is not installed.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> seen = {"point_cloud": torch.full((1, 16, 3), torch.nan), "altitude": torch.full((1, 1), 3.5)}
        >>> still = {"velocity": torch.zeros(1, 3), "attitude": torch.zeros(1, 3), "heading_deg": torch.zeros(1, 1)}
        >>> state = TensorDict({**seen, **still, "is_init": torch.ones(1, 1, dtype=bool)}, [1])
        >>> RRTMap()(state)["action"].round(decimals=3).abs().tolist()
        [[2.0, 0.0, 0.0, 0.0]]
    """

    has_map = True  # which needs the goal's own direction, not that of another map's waypoint

    def __init__(
        self,
        flight_level: float = VEHICLE.flight_level,
        radius: Annotated[float, Field(gt=0, le=100)] = 4.0,
        *,
        seconds: Positive = 10.0,
        motion: float | None = None,
        tries: Annotated[int, Field(ge=1, le=100_000)] = 150,
        seed: Seed = 0,
        costs: RRTConnectWeights | None = None,
        airframe: OrMapping[Airframe] | None = None,
        cell: Annotated[float, Field(ge=0.1, le=1)] = 0.25,
        reach: Annotated[float, Field(ge=5, le=100)] = 40.0,
        max_speed: float = VEHICLE.velocity_limit,
    ) -> None:
        super().__init__(
            flight_level,
            radius,
            seconds=seconds,
            motion=motion,
            tries=tries,
            seed=seed,
            costs=costs,
            airframe=airframe,
            max_speed=max_speed,
        )
        self.cell, self.reach = cell, reach
        self._maps: list[EpisodeMap] = []
        self._goals: list[GoalFinder] = []
        self._routes: list[np.ndarray | None] = []

    def aim(self, one: int, seen: Surroundings, plans: bool) -> tuple[np.ndarray, float]:
        """The direction of a point of the route, and how far it is: at most as far as is planned."""
        if len(self._maps) != len(seen.fresh):
            self._maps = [EpisodeMap(self.cell, self.reach, self.vehicle.radius) for _ in seen.fresh]
            self._goals = [GoalFinder(self.reach) for _ in seen.fresh]
            self._routes = [None for _ in seen.fresh]
        if seen.fresh[one, 0]:
            self._maps[one], self._routes[one] = EpisodeMap(self.cell, self.reach, self.vehicle.radius), None
            self._goals[one] = GoalFinder(self.reach)
        yaw, place = float(seen.yaw[one]), seen.place[one].double().numpy()[:2]
        turn = yaw_rotation(yaw)[:2, :2]
        goal, points = seen.goal[one].double().numpy(), np.zeros((0, 2))
        if plans:
            cloud = seen.cloud[one].double().numpy()
            points = cloud[np.abs(cloud[:, 2] + float(seen.altitude[one]) - self.vehicle.flight_level) < LEVEL, :2]
            points = points @ turn.T + place
        known, there = self._maps[one], self._goals[one].look(place, turn @ goal[:2])
        known.look(points, place)
        if plans:
            self._routes[one] = known.route(place, there)
        way = self._routes[one]
        if way is None:
            return goal, self.costs.ahead
        point, straight = waypoint(way, place, known.middles(), self.costs.ahead, self.vehicle.radius)
        apart = np.append((way[point] - place) @ turn, 0.0)
        far = float(np.linalg.norm(apart))
        return apart / max(far, 1e-6), self.costs.ahead if straight else far
