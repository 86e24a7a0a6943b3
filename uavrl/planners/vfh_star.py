"""A vector field histogram with memory and a look ahead: a rival of what is learned."""

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

ELEVATIONS = (-0.5, 0.0, 0.5)  # rad, of the directions
AZIMUTHS, AZIMUTHS_BEYOND = 24, 12  # of the first directions, and of those from a node
BLENDED = math.cos(0.3)  # directions within this angle, in rad, of the best one are blended with it
OUTSIDE = 5.0  # cost of a metre beyond the altitudes in which one may fly


@dataclass(frozen=True)
class VFHStarWeights:
    """What a direction costs a :class:`VFHStar`, and how fast it is flown.

    The numbers are first guesses, of which one was corrected by watching 32 tasks in valleys 200 to 209. Of 24 settings
    that ``python studies/tune_rivals.py vfh_star`` flew there none was clearly better: 46 of 48 tasks with these, 47
    with the best two.
    """

    blocked: float = 5.0  #: cost of a direction in which the hull would meet something at once
    obstacle: float = 2.0  #: cost of a direction that passes something as near as may be, at once
    goal: float = 1.0  #: cost of a direction that leads away from the goal
    level: float = 0.3  #: cost of a metre off the flight level after a step of the look-ahead
    change: float = 0.2  #: cost of a direction away from the one before
    near: float = 0.15  #: m that are kept between hull and obstacle
    far: float = 0.7  #: m between hull and obstacle from which on it costs nothing
    reach: float = 3.0  #: m ahead up to which an obstacle costs
    soon: float = 1.0  #: power of the share of the reach that is left; the greater, the less far things count
    step: float = 1.0  #: m from node to node
    discount: float = 0.8  #: of the cost of each further step
    caution: float = 0.5  #: share of the speed that is left out where an obstacle is near
    brake: float = 0.5  #: s, share of the free way that it flies in a second; it could stop in twice that


class LineClearances(NamedTuple):
    """What lies on lines from S starts in D directions, ``[S, D]`` each."""

    threat: Tensor  #: how near the nearest obstacle is, beside the line and ahead, in [0, 1]
    free: Tensor  #: m until the hull comes within half the distance to keep of something, at most the reach


def look_along(
    points: Tensor, starts: Tensor, directions: Tensor, costs: VFHStarWeights, hull: Hull = VEHICLE.hull
) -> LineClearances:
    """What the hull of one vehicle would meet on straight lines, each obstacle enlarged by the hull and a distance.

    Source: Ulrich and Borenstein (1998), VFH+: an obstacle at distance d fills all directions within
    asin((r + d_s) / d); here without cells. The hull is flat: heights are stretched until it is as high as wide.

    Args:
        points: obstacles, ``[P, 3]`` m.
        starts: of the lines, ``[S, D, 3]``, or ``[S, 1, 3]`` for all directions, m.
        directions: unit vectors ``[D, 3]``.
        costs: distances to keep.
        hull: its radius, and half its height, m.

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
    """Looks some steps ahead through the obstacles of the last seconds, and flies the first step of the best way.

    Each direction costs what stands in it, its angle to the goal, to the one before and its height. In each azimuth
    the cheapest is followed to a node, whose directions cost likewise, and of which the cheapest is followed again: the
    tree has 24 branches, which do not fork. VFH* follows all free directions from each node, until one way is best.

    Sources: Baumann (2018), Obstacle avoidance for drones using a 3DVFH* algorithm, for three dimensions and the
    memory of points; Ulrich and Borenstein (2000), VFH*, for the look-ahead. It knows no distance to the
    goal, only its direction, as the policies do. The first line begins where the vehicle's own speed carries it.

    Args:
        flight_level: altitude to hold where nothing is in the way, m.
        radius: how far it sees, m; what lies farther is not used.
        seconds: for which obstacles are remembered.
        motion: how far moving objects are looked for, as in :class:`uavrl.transforms.NavigationState`, to keep out of
            their ways; None: what moves is taken for standing.
        depth: steps that are looked ahead.
        costs: None for the ones above.
        airframe: whose hull and LiDAR it reckons with; None for the default one.
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
        self._flown = torch.zeros(0, 3, dtype=torch.float32)  # unit vectors, which way was flown last; 0 for none

    def steer(self, seen: Surroundings) -> tuple[Tensor, Tensor]:
        """The velocities of the best ways' first steps, and yaw rates to the goal."""
        if len(self._flown) != len(seen.fresh):
            self._flown = torch.zeros(len(seen.fresh), 3, dtype=torch.float32)
        self._flown = self._flown.masked_fill(seen.fresh, 0.0)
        forward = seen.velocity @ self.directions.T
        start = LAG * (seen.velocity[:, None] - forward[..., None] * self.directions)  # [N, D, 3]: where lines begin
        lines = self._look(seen.points, start[:, None], self.directions)
        height = seen.altitude + start[..., 2] + self.costs.step * self.directions[:, 2]
        cost = self._cost(lines, self.directions, seen.goal, height, self._flown[:, None])
        way, speed = self._blended(cost + self._ahead(cost, start, seen), lines)
        self._flown = way
        return speed * way, seen.turn

    def _look(self, points: list[Tensor], starts: Tensor, directions: Tensor) -> LineClearances:
        """What lies on lines from ``starts [N, S, D, 3]``: ``[N * S, D]``, vehicle by vehicle, which a cache holds."""
        each = [
            look_along(*pair, directions, self.costs, self.vehicle.hull) for pair in zip(points, starts, strict=True)
        ]
        return LineClearances(*(torch.cat(told) for told in zip(*each, strict=True)))

    def _cost(self, lines: LineClearances, directions: Tensor, goal: Tensor, height: Tensor, before: Tensor) -> Tensor:
        """What each direction costs, ``[B, D]``.

        Source: Baumann (2018), section 3.1, and Ulrich and Borenstein (2000), VFH*, for the cost of a change.

        Args:
            lines: what lies in the directions.
            directions: unit vectors ``[D, 3]``.
            goal: unit vectors ``[B, 3]``.
            height: that they lead to, ``[B, D]`` m.
            before: the directions before, ``[B, 1, 3]``, 0 for none.
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
        """What the ways cost that go on from the first directions, ``[N, D]``, the same at all elevations.

        Source: Ulrich and Borenstein (2000), VFH*: nodes lie ``step`` apart, and each further one counts less.

        Args:
            cost: of the first directions, ``[N, D]``.
            start: where they begin, ``[N, D, 3]`` m.
            seen: what is around.
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
        """The way, a unit vector ``[N, 3]``, and the speed ``[N, 1]``, of the best direction and its neighbours."""
        costs = self.costs
        weight, way = blended(cost, self._close, costs.goal, self.directions)
        speed = (lines.free / costs.brake).clamp_max(self.vehicle.velocity_limit) * (1 - costs.caution * lines.threat)
        return way, (weight * speed).sum(-1, keepdim=True)
