"""VFH*, a vector field histogram with a memory of points and a look-ahead tree, to compare learned policies with."""

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from uavrl.envs.limits import OrMapping
from uavrl.envs.quadrotor import Airframe
from uavrl.planners.point_memory import Planner, Surroundings
from uavrl.policies.baselines import blended
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl_onboard.geometry import off_altitudes, stretch
from uavrl_onboard.perception.cells import grid_directions
from uavrl_onboard.perception.motion.threats import LAG
from uavrl_onboard.ranges import Positive
from uavrl_onboard.vehicle import VEHICLE, Hull

ELEVATIONS = (-0.5, 0.0, 0.5)  # elevations of the directions, rad
AZIMUTHS, AZIMUTHS_BEYOND = 24, 12  # number of azimuths of the first directions, and of the directions from a node
BLENDED = math.cos(0.3)  # The best direction is blended with those within 0.3 rad of it.
OUTSIDE = 5.0  # cost of each metre outside the allowed altitudes


@dataclass(frozen=True)
class VFHStarWeights:
    """The costs of a direction for a :class:`VFHStar`, and the numbers that determine its speed.

    The numbers are first guesses. We corrected one of them after watching 32 tasks in valleys 200 to 209. We then ran
    ``python studies/tune_rivals.py vfh_star``, which tries 24 settings there, and none was clearly better: these
    succeed in 46 of 48 tasks, and the best two settings in 47.
    """

    blocked: float = 5.0  #: cost of a direction in which the hull would hit an obstacle at once
    obstacle: float = 2.0  #: cost of a direction that at once passes an obstacle at the smallest allowed distance
    goal: float = 1.0  #: cost of a direction that leads away from the goal
    level: float = 0.3  #: cost of each metre off the flight level after a step of the look-ahead
    change: float = 0.2  #: cost of a direction that leads away from the previous one
    near: float = 0.15  #: distance to keep between hull and obstacle, m
    far: float = 0.7  #: distance between hull and obstacle beyond which the obstacle costs nothing, m
    reach: float = 3.0  #: distance ahead beyond which an obstacle costs nothing, m
    soon: float = 1.0  #: exponent of the remaining share of the reach; the larger, the less distant obstacles count
    step: float = 1.0  #: distance between nodes, m
    discount: float = 0.8  #: factor on the cost of each further step
    caution: float = 0.5  #: share of the speed that it gives up beside a near obstacle
    brake: float = 0.5  #: time in which it would fly the free distance ahead, s; it can stop in twice that time


class LineClearances(NamedTuple):
    """The obstacles on lines from S starts in D directions, ``[S, D]`` each."""

    threat: Tensor  #: nearness of the nearest obstacle, beside the line and along it, in [0, 1]
    free: Tensor  #: distance, m, at which the hull is within half of ``near`` of an obstacle; at most the reach


def look_along(
    points: Tensor, starts: Tensor, directions: Tensor, costs: VFHStarWeights, hull: Hull = VEHICLE.hull
) -> LineClearances:
    """Return what the hull of one vehicle would hit on straight lines, with obstacles enlarged by hull and distance.

    Source: Ulrich and Borenstein (1998), VFH+. There, an obstacle at distance d blocks all directions within
    asin((r + d_s) / d). Here there are no cells. The hull is flat, so heights are stretched until it is as high as it
    is wide.

    Args:
        points: the obstacles, ``[P, 3]`` m.
        starts: the starts of the lines, ``[S, D, 3]``, or ``[S, 1, 3]`` for all directions, m.
        directions: unit vectors ``[D, 3]``.
        costs: contain the distances to keep.
        hull: the radius of the hull, and half its height, m.

    Examples:
        >>> ahead, origin = torch.tensor([[1.0, 0.0, 0.0]]), torch.zeros(1, 1, 3)
        >>> look_along(torch.tensor([[2.0, 0.0, 0.0], [1.0, 3.0, 0.0]]), origin, ahead, VFHStarWeights()).free
        tensor([[1.6500]])
    """
    factors = call_numpy(stretch, costs.near, hull)
    points, starts, directions = (each * factors for each in (points, starts, directions))
    squared = (directions * directions).sum(-1)[:, None]  # [D, 1]
    began = (starts * directions).sum(-1)[..., None]  # [S, D, 1]
    along = (directions @ points.T - began).div_(squared)  # [S, D, P], m
    apart = (starts @ points.T).mul_(-2).add_((points * points).sum(-1)).add_((starts * starts).sum(-1)[..., None])
    beside = (along * along).mul_(-squared).add_(apart).clamp_min_(0).sqrt_().sub_(hull[0])  # m from the hull
    behind = along <= 0
    free = (along - hull[0]).clamp_min_(0).masked_fill_(behind | (beside > costs.near / 2), costs.reach)
    side = beside.sub_(costs.far).div_(costs.near - costs.far).clamp_(0, 1)
    soon = along.div_(-costs.reach).add_(1).clamp_min_(0).pow_(costs.soon)
    threat = side.mul_(soon).masked_fill_(behind, 0)
    if not len(points):
        return LineClearances(began[..., 0] * 0, torch.full_like(began[..., 0], costs.reach))
    return LineClearances(threat.amax(-1), free.amin(-1).clamp_max(costs.reach))


class VFHStar(Planner):
    """Plan some steps ahead among the obstacles of the last seconds, and fly the first step of the best path.

    The cost of a direction depends on its obstacles, its angles to the goal and to the previous direction, and its
    height. In each azimuth, the planner follows the cheapest direction to a node. From there it follows the cheapest
    direction again. The tree therefore has 24 branches that do not fork. The original VFH* follows all free directions
    from each node until one path is best.

    Sources: Baumann (2018), Obstacle avoidance for drones using a 3DVFH* algorithm, for three dimensions and the
    memory of points; Ulrich and Borenstein (2000), VFH*, for the look-ahead. Like the policies, the planner receives
    the direction of the goal and not its distance. The first line begins where the vehicle's velocity will have carried
    it when the command takes effect.

    Args:
        flight_level: altitude to hold if nothing is in the way, m.
        radius: distance up to which it uses points, m.
        seconds: how long obstacles are remembered, s.
        motion: distance up to which moving obstacles are detected and avoided, as in
            :class:`uavrl.transforms.NavigationState`; None: they are treated as static.
        depth: number of steps to look ahead.
        costs: None for the defaults of :class:`VFHStarWeights`.
        airframe: the airframe whose hull and LiDAR it assumes; None for the default one.
        max_speed: limit of each component of the velocity, m/s.

    Examples:
        >>> from tensordict import TensorDict
        >>> seen = {"point_cloud": torch.full((1, 16, 3), torch.nan), "altitude": torch.full((1, 1), 3.5)}
        >>> still = {"velocity": torch.zeros(1, 3), "attitude": torch.zeros(1, 3), "heading_deg": torch.zeros(1, 1)}
        >>> state = TensorDict({**seen, **still, "is_init": torch.ones(1, 1, dtype=bool)}, [1])
        >>> VFHStar()(state)["action"].round(decimals=3).abs().tolist()
        [[2.0, 0.0, 0.0, 0.0]]
    """

    def __init__(
        self,
        flight_level: float = VEHICLE.flight_level,
        radius: Annotated[float, Field(gt=0, le=100)] = 4.0,
        *,
        seconds: Positive = 10.0,
        motion: float | None = None,
        depth: Annotated[int, Field(ge=0, le=10)] = 2,
        costs: VFHStarWeights | None = None,
        airframe: OrMapping[Airframe] | None = None,
        max_speed: float = VEHICLE.velocity_limit,
    ) -> None:
        super().__init__(flight_level, radius, seconds, motion, airframe, max_speed=max_speed)
        self.depth = depth
        self.costs = VFHStarWeights() if costs is None else costs
        self.directions = torch.from_numpy(grid_directions(AZIMUTHS, ELEVATIONS)).float()
        self._beyond = torch.from_numpy(grid_directions(AZIMUTHS_BEYOND, ELEVATIONS)).float()
        self._close = self.directions @ self.directions.T > BLENDED
        self._flown = torch.zeros(0, 3, dtype=torch.float32)  # previous directions, as unit vectors; 0 for none

    def steer(self, seen: Surroundings) -> tuple[Tensor, Tensor]:
        """Return the velocities of the first steps of the best paths, and yaw rates towards the goal."""
        if len(self._flown) != len(seen.fresh):
            self._flown = torch.zeros(len(seen.fresh), 3, dtype=torch.float32)
        self._flown = self._flown.masked_fill(seen.fresh, 0.0)
        forward = seen.velocity @ self.directions.T
        start = LAG * (seen.velocity[:, None] - forward[..., None] * self.directions)  # starts of the lines, [N, D, 3]
        lines = self._look(seen.points, start[:, None], self.directions)
        height = seen.altitude + start[..., 2] + self.costs.step * self.directions[:, 2]
        cost = self._cost(lines, self.directions, seen.goal, height, self._flown[:, None])
        way, speed = self._blended(cost + self._ahead(cost, start, seen), lines)
        self._flown = way
        return speed * way, seen.turn

    def _look(self, points: list[Tensor], starts: Tensor, directions: Tensor) -> LineClearances:
        """Return the obstacles on lines from ``starts [N, S, D, 3]``: ``[N * S, D]``.

        One vehicle at a time is computed, so that its intermediate results fit into the processor's cache.
        """
        each = [
            look_along(*pair, directions, self.costs, self.vehicle.hull) for pair in zip(points, starts, strict=True)
        ]
        return LineClearances(*(torch.cat(told) for told in zip(*each, strict=True)))

    def _cost(self, lines: LineClearances, directions: Tensor, goal: Tensor, height: Tensor, before: Tensor) -> Tensor:
        """Return the cost of each direction, ``[B, D]``.

        Source: Baumann (2018), section 3.1, and Ulrich and Borenstein (2000), VFH*, for the cost of a change.

        Args:
            lines: the obstacles in the directions.
            directions: unit vectors ``[D, 3]``.
            goal: unit vectors ``[B, 3]`` towards the goal.
            height: the height to which each direction leads, ``[B, D]`` m.
            before: the previous directions, ``[B, 1, 3]``; 0 for none.
        """
        costs, off = self.costs, height - self.vehicle.flight_level
        return (
            costs.blocked * (1 - lines.free / costs.reach)
            + costs.obstacle * lines.threat
            + costs.goal * (1 - goal @ directions.T)
            + costs.level * off.abs()
            + OUTSIDE * call_numpy(off_altitudes, off, self.vehicle)
            + costs.change * (before.norm(dim=-1) - (before * directions).sum(-1))
        )

    def _ahead(self, cost: Tensor, start: Tensor, seen: Surroundings) -> Tensor:
        """Return the cost of the path beyond each first direction, ``[N, D]``, the same for all elevations.

        Source: Ulrich and Borenstein (2000), VFH*: nodes are ``step`` apart, and each further node counts less.

        Args:
            cost: the costs of the first directions, ``[N, D]``.
            start: the starts of the lines, ``[N, D, 3]`` m.
            seen: the surroundings of the vehicles.
        """
        each, step = len(ELEVATIONS), self.costs.step
        first = cost.unflatten(1, (AZIMUTHS, each)).argmin(-1) + each * torch.arange(AZIMUTHS)  # [N, A]
        way = self.directions[first]
        place = start[torch.arange(len(cost))[:, None], first] + step * way  # [N, A, 3]
        goals, ahead = seen.goal.repeat_interleave(AZIMUTHS, 0), cost.new_zeros(first.shape)
        for depth in range(1, self.depth + 1):
            lines = self._look(seen.points, place[:, :, None], self._beyond)
            height = (seen.altitude + place[..., 2]).reshape(-1, 1) + step * self._beyond[:, 2]
            least, child = self._cost(lines, self._beyond, goals, height, way.reshape(-1, 1, 3)).min(-1)
            way = self._beyond[child].view_as(place)
            place, ahead = place + step * way, ahead + self.costs.discount**depth * least.view_as(ahead)
        return ahead.repeat_interleave(each, 1)

    def _blended(self, cost: Tensor, lines: LineClearances) -> tuple[Tensor, Tensor]:
        """Return the best direction blended with its neighbours, unit vectors ``[N, 3]``, and the speed ``[N, 1]``."""
        costs = self.costs
        weight, way = blended(cost, self._close, costs.goal, self.directions)
        speed = (lines.free / costs.brake).clamp_max(self.vehicle.velocity_limit) * (1 - costs.caution * lines.threat)
        return way, (weight * speed).sum(-1, keepdim=True)
