"""RRT-Connect on a map of what was seen, and a reflex where that finds nothing: a rival of what is learned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from uavrl.envs.limits import OrMapping
from uavrl.envs.quadrotor import Airframe
from uavrl.planners.mppi import limited
from uavrl.planners.ompl_search import APART, filled, length, load_ompl, pushed_out, search
from uavrl.planners.point_memory import PERIOD, Planner, Surroundings
from uavrl_onboard.geometry import heading_vector, stretch, world_to_yaw, yaw_to_world
from uavrl_onboard.guards.map.lines import Obstacles, clearances
from uavrl_onboard.ranges import Positive, Seed
from uavrl_onboard.vehicle import VEHICLE

EVERY = round(0.5 / PERIOD)  # steps between two plans: 2 Hz
TURNS = np.deg2rad([0] + [side * turn for turn in range(15, 181, 15) for side in (1, -1)])  # from the goal's direction
SHORT = 1.0  # m of an old path that are left when it is no longer worth to be kept for itself
SPAN = 1.0  # m up and down in which ways are looked for: scans lie within 15 degrees
ON_PATH = 0.85  # share of what is kept from obstacles, the hull included, that an old path must still keep
CLIMB = 0.5  # m/s up or down for each m/s on the level, at most


@dataclass(frozen=True)
class RRTConnectWeights:
    """How an :class:`RRTConnect` plans, follows its path, and evades.

    The numbers are, rounded, the best of 24 settings that ``python studies/tune_rivals.py rrt_connect`` flew in valleys
    200 to 209: all of 48 tasks, 106 steps each. The first guesses had 47, 115 steps.
    """

    ahead: float = 2.5  #: m to the point that is planned to
    near: float = 0.26  #: m that are kept between hull and obstacle
    far: float = 0.42  #: m between hull and obstacle from which on it flies at full speed
    lead: float = 0.69  #: share of the way to rest from whose end it plans
    stride: float = 1.0  #: m, the longest step of a tree
    keep: float = 0.66  #: a new path must be shorter than this share of the old one
    carrot: float = 1.3  #: m along the path to the point that it flies at
    slow: float = 0.73  #: m/s where an obstacle is as near as may be
    watch: float = 1.1  #: m of the path ahead that must be free, or the reflex acts
    reflex: float = 0.64  #: m/s along an obstacle, by the reflex
    distance: float = 0.31  #: d_0, m between hull and obstacle that the reflex keeps
    gain: float = 0.59  #: 1/s, speed to or from the obstacle for each metre off that distance


@dataclass
class Pilot:
    """What one vehicle holds on to from step to step."""

    age: int = 0  # steps since the episode began
    path: np.ndarray | None = None  # [K, 3] m since the episode's start, world axes
    side: float = 0.0  # on which the reflex has the obstacle: 1 flies with it on the right, 0 before it acts


class RRTConnect(Planner):
    """Plans a way through what it remembers twice a second, follows it, and evades by a reflex where there is none.

    The way leads to a point at the edge of sight, in the goal's direction, or the free one that is nearest to it; what
    was not seen counts as free. A straight way is taken where it is free; an old one is kept, unless a new one is much
    shorter. As soon as a scan shows something on the way, or where none is found, the reflex flies along the nearest
    obstacle, on the side that leads to the goal, until there is a way again.

    Sources: Kuffner and LaValle (2000), RRT-Connect; the idea of a sliding-mode reflex beside it is that of Elmokadem
    and Savkin (2021), A hybrid approach for autonomous collision-free UAV navigation in 3D partially unknown dynamic
    environments, Drones 5, 57, of which the abstract alone was at hand: the reflex here is our own reading. The map is
    what was seen, the reflex is level, and its sliding surface is flown as a velocity.
    It knows no distance to the goal, only its direction.

    Vehicles of one age share OMPL's seed, so that an episode does not depend on what flies beside it. OMPL has one seed
    for all of a process, which each plan sets.

    Args:
        flight_level: altitude to hold where nothing is in the way, m.
        radius: how far it sees, m; what lies farther is not used.
        seconds: for which obstacles are remembered.
        motion: how far moving objects are looked for, as in :class:`uavrl.transforms.NavigationState`, to keep out of
            their ways; None: what moves is taken for standing.
        tries: times that a tree grows for a plan, at most.
        seed: of the plans.
        costs: None for the ones above.
        airframe: whose hull and LiDAR it reckons with; None for the default one.
        max_speed: limit of each component of the velocity, m/s.

    Raises:
        UavrlError: where OMPL is not installed.

    Examples:
        >>> from tensordict import TensorDict
        >>> seen = {"point_cloud": torch.full((1, 16, 3), torch.nan), "altitude": torch.full((1, 1), 3.5)}
        >>> still = {"velocity": torch.zeros(1, 3), "attitude": torch.zeros(1, 3), "heading_deg": torch.zeros(1, 1)}
        >>> state = TensorDict({**seen, **still, "is_init": torch.ones(1, 1, dtype=bool)}, [1])
        >>> RRTConnect()(state)["action"].round(decimals=3).abs().tolist()
        [[2.0, 0.0, 0.0, 0.0]]
    """

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
        max_speed: float = VEHICLE.velocity_limit,
    ) -> None:
        super().__init__(flight_level, radius, seconds, motion, airframe, max_speed=max_speed)
        load_ompl()
        self.tries, self.seed = tries, seed
        self.costs = RRTConnectWeights() if costs is None else costs
        self._stretch = stretch(self.costs.near, self.vehicle.hull).astype(float)
        self._pilots: list[Pilot] = []

    def steer(self, seen: Surroundings) -> tuple[Tensor, Tensor]:
        """The velocities to the next points of the paths, or along obstacles, and yaw rates to the goal."""
        if len(self._pilots) != len(seen.fresh):
            self._pilots = [Pilot() for _ in seen.fresh]
        velocities = []
        for one, fresh in enumerate(seen.fresh[:, 0].tolist()):
            if fresh:
                self._pilots[one] = Pilot()
            velocities.append(self._fly(self._pilots[one], one, seen))
        velocity = torch.from_numpy(np.stack(velocities)).float()
        return limited(velocity, self.vehicle.velocity_limit, CLIMB), seen.turn

    def _fly(self, pilot: Pilot, one: int, seen: Surroundings) -> np.ndarray:
        """The velocity of one vehicle, ``[3]`` m/s; all places are stretched, in level axes of its yaw."""
        costs = self.costs
        carried = seen.carried[one].double().numpy()
        off = float(seen.altitude[one]) - self.vehicle.flight_level
        start = costs.lead * carried * self._stretch
        points = seen.cloud[one].double().numpy()
        points = points[np.abs(points[:, 2]) < max(SPAN, abs(off)) + self.vehicle.radius] * self._stretch
        begin = pushed_out(points, start, self.vehicle.radius + costs.near)
        obstacles = Obstacles(points, begin, self.vehicle.radius + costs.near)
        left = None if pilot.path is None else self._left(pilot.path, one, seen)
        goal, far = self.aim(one, seen, pilot.age % EVERY == 0)
        if pilot.age % EVERY == 0:
            left = self._planned(obstacles, begin, self._target(obstacles, goal, far, off, left), off, left, pilot.age)
            pilot.path = None if left is None else self._kept(left, one, seen)
        pilot.age += 1
        if left is None or not self._open(obstacles, left[: round(costs.watch / APART) + 1]):
            velocity, pilot.side = self._reflex(points, start, goal, pilot.side)
            return velocity
        pilot.side = 0.0
        return self._follow(obstacles, start, left)

    def aim(self, one: int, seen: Surroundings, plans: bool) -> tuple[np.ndarray, float]:
        """Where a vehicle wants to get: a level unit vector ``[3]``, and how far, m; ``plans``: a plan is due."""
        return seen.goal[one].double().numpy(), self.costs.ahead

    def _left(self, path: np.ndarray, one: int, seen: Surroundings) -> np.ndarray:
        """What is left of a path: ``[K, 3]`` m, stretched, in axes of the yaw."""
        yaw, place = float(seen.yaw[one]), seen.place[one].double().numpy()
        ahead = world_to_yaw(path - place, yaw) * self._stretch
        start = self.costs.lead * seen.carried[one].double().numpy() * self._stretch
        return ahead[int(((ahead - start) ** 2).sum(1).argmin()) :]

    def _kept(self, path: np.ndarray, one: int, seen: Surroundings) -> np.ndarray:
        """A path as it is remembered: the reverse of the above."""
        yaw, place = float(seen.yaw[one]), seen.place[one].double().numpy()
        return place + yaw_to_world(path / self._stretch, yaw)

    def _open(self, obstacles: Obstacles, path: np.ndarray) -> bool:
        """Whether nothing has come onto a path."""
        return bool(obstacles.free(path, path, ON_PATH).all())

    def _target(
        self, obstacles: Obstacles, goal: np.ndarray, far: float, off: float, left: np.ndarray | None
    ) -> np.ndarray | None:
        """The point ``[3]`` to plan to: free, ``far`` m away, as near to the goal's direction as may be."""
        heading = np.arctan2(goal[1], goal[0])
        turns = TURNS if left is None or goal[0] * left[-1, 1] - goal[1] * left[-1, 0] >= 0 else -TURNS
        height = -off * self._stretch[2] * np.ones(len(turns))
        ends = np.column_stack([far * heading_vector(heading + turns), height])
        free = obstacles.free(ends, ends)
        return ends[free.argmax()] if free.any() else None

    def _planned(
        self,
        obstacles: Obstacles,
        start: np.ndarray,
        target: np.ndarray | None,
        off: float,
        left: np.ndarray | None,
        age: int,
    ) -> np.ndarray | None:
        """The path from now on, ``[K, 3]`` m: straight on, the old one, or a new one; None for none."""
        if left is not None and not self._open(obstacles, left):
            left = None
        short = left is None or length(left) < SHORT
        if target is None:
            return None if short else left
        straight = np.stack([start, target])
        if obstacles.free(straight[:1], straight[1:])[0]:
            return filled(straight)
        wide, level = self.costs.ahead + 0.5, self._stretch[2]
        low, high = max(self.vehicle.lowest - off, -SPAN) * level, min(self.vehicle.highest - off, SPAN) * level
        box = np.array([[-wide, -wide, min(low, start[2], target[2])], [wide, wide, max(high, start[2], target[2])]])
        found = search(obstacles, start, target, box, self.costs.stride, self.tries, self.seed + age // EVERY + 1)
        if left is not None:
            on = np.concatenate([left, target[None]])
            if obstacles.free(on[-2:-1], on[-1:])[0]:
                if found is None or length(found) > self.costs.keep * length(on):
                    return np.concatenate([left[:-1], filled(on[-2:])])
            elif not short:
                return left
        return None if found is None else filled(found)

    def _follow(self, obstacles: Obstacles, start: np.ndarray, left: np.ndarray) -> np.ndarray:
        """The velocity ``[3]`` at the point of a path that is some way ahead, slower where it is narrow."""
        costs = self.costs
        near = left[: round(costs.carrot / APART) + 1]
        free = obstacles.free(np.broadcast_to(start, near.shape), near)
        carrot = near[int(free.nonzero()[0].max(initial=min(2, len(near) - 1)))]
        beside = clearances(obstacles.points, start[None], carrot[None]).min(initial=np.inf) - self.vehicle.radius
        wide = float(np.clip((beside - costs.near / 2) / (costs.far - costs.near / 2), 0, 1))
        way = (carrot - start) / self._stretch
        return (
            (costs.slow + (self.vehicle.velocity_limit - costs.slow) * wide)
            * way
            / max(float(np.linalg.norm(way)), 0.1)
        )

    def _reflex(self, points: np.ndarray, start: np.ndarray, goal: np.ndarray, side: float) -> tuple[np.ndarray, float]:
        """The velocity ``[3]`` along the nearest obstacle, and on which side that is.

        After the idea of Elmokadem and Savkin (2021): the speed to or from the obstacle is that of a sliding surface,
        d' + chi(d - d_0) = 0, where chi is linear and saturates; what is left of the speed leads along it.
        """
        costs = self.costs
        if not len(points):
            return costs.reflex * goal, 0.0
        apart = start - points
        distances = np.sqrt((apart * apart).sum(1))
        nearest = int(distances.argmin())
        away = apart[nearest] * [1.0, 1.0, 0.0]
        away = away / max(float(np.linalg.norm(away)), 1e-6)
        along = np.array([-away[1], away[0], 0.0])
        side = side or (1.0 if along @ goal >= 0 else -1.0)
        off = distances[nearest] - self.vehicle.radius - costs.distance
        back = -float(np.clip(costs.gain * off, -costs.reflex, costs.reflex))
        return back * away + side * np.sqrt(costs.reflex**2 - back**2) * along, side
