"""Policies that learn nothing: yardsticks for a task's difficulty."""

import math
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from uavrl.envs.limits import OrMapping, settings
from uavrl.envs.quadrotor import Airframe
from uavrl.errors import UavrlError
from uavrl.policy_protocol import PolicyModule
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl.transforms.reduction import Statistic
from uavrl.transforms.state import REDUCTIONS, cell_directions
from uavrl.transforms.threats import DIRECTIONS
from uavrl_onboard.geometry import world_to_yaw
from uavrl_onboard.guards.evade import evade
from uavrl_onboard.guards.shield import Shield, closing_speeds, keep_within, sight_at
from uavrl_onboard.perception.cells import VLP16_GRID, RangeGrid
from uavrl_onboard.perception.motion.threats import straight_on
from uavrl_onboard.perception.reductions import Reduction
from uavrl_onboard.vehicle import DECELERATION, REACTION, VEHICLE

TURN_GAIN = 0.6  # 1/s, yaw rate over the angle to the way that is flown
TURN_LIMIT = 1.0  # rad/s; at 2 rad/s a command that is 0.2 s late points 23 degrees elsewhere
NOMINAL = VEHICLE.velocity_limit  # m/s, for which the costs were chosen
CLEAR = 0.2  # m, between hull and obstacle, where a vehicle would stand
AHEAD = math.cos(0.45)  # directions within this angle, in rad, of a cell's must be free to stop in
STANDING = 0.1  # share of the largest velocity below which a vehicle flies in no direction
BEHIND = 60.0  # degrees to either side of straight behind; with 30 the yaw still reversed, in 16 of 200 starts
BLENDED = math.cos(0.6)  # directions within this angle, in rad, of the best one are blended with it
SHARPNESS = 20.0  # of the blend: a direction weighs e times less for each 1/20 of the goal's cost that it costs more
# Of a controller that keeps headway, as the shield:
LAG = Shield.lag  # s until a commanded velocity is flown
# Takes arrays: call_numpy hands it tensors.
keep_headway = partial(keep_within, corrections=10, shares=(1.0, 0.5), slack=0.0)


def wrapped_heading(heading_deg: Tensor) -> Tensor:
    """Headings to the goal in degrees as angles in [-π, π) rad.

    Examples:
        >>> wrapped_heading(torch.tensor([-90.0, 270.0])).tolist()
        [-1.5707963705062866, -1.5707963705062866]
    """
    return torch.deg2rad((heading_deg + 180).remainder(360) - 180)


class StraightPolicy(PolicyModule):
    """Turns to the goal on the spot and then flies straight at it at full speed, blind to obstacles.

    Args:
        flight_level: altitude to hold, m.
        cone: half-angle within which it flies, rad.
        max_speed: limit of each component of the velocity, m/s.

    Examples:
        >>> from tensordict import TensorDict
        >>> state = TensorDict({"heading_deg": torch.tensor([[0.0], [90.0]]), "altitude": torch.full((2, 1), 3.5)}, [2])
        >>> StraightPolicy()(state)["action"].tolist()
        [[2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0]]
    """

    def __init__(
        self,
        flight_level: float = VEHICLE.flight_level,
        cone: float = 0.15,
        max_speed: float = VEHICLE.velocity_limit,
    ) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["heading_deg", "altitude"], ["action"]
        self.flight_level, self.cone, self.max_speed = flight_level, cone, max_speed

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action`` from ``heading_deg`` and ``altitude``."""
        heading = wrapped_heading(tensordict["heading_deg"])
        limit = self.max_speed
        fastest_turn = min(limit, VEHICLE.yaw_rate_limit)  # as the environment's actions have it
        forward = limit * (heading.abs() < self.cone).float()
        climb = (self.flight_level - tensordict["altitude"]).clamp(-limit, limit)
        turn = (3 * heading).clamp(-fastest_turn, fastest_turn)
        return tensordict.set("action", torch.cat([forward, torch.zeros_like(forward), climb, turn], -1))


@dataclass(frozen=True)
class VFHWeights:
    """What a direction costs a :class:`VectorFieldHistogram`, and how fast it is flown."""

    obstacle: float  #: cost of a direction whose cell is full
    goal: float  #: cost of a direction that leads away from the goal
    level: float  #: cost of a metre off the flight level after a second, in a direction
    turn: float  #: cost of a direction behind the UAV
    width: float  #: how near a cell must be to a direction to count (the power of the cosine between them)
    nearness: float  #: power of what a cell tells over the radius; the greater, the less far things count
    caution: float  #: share of the speed that is left out where the way is full, in [0, 1]
    change: float = 0.0  #: cost of a direction away from that of the last action, where that is known
    headway: float = 0.0  #: least seconds for closing the gap to an obstacle; with 0, gaps bound no speed


# Chosen in valleys 200 to 209: the first by studies/tune_vfh.py, but for its level, 0.121 there, with which climbing
# 0.96 m/s cost more on the way to the goal than it saved; the last as the best of a dozen tried by hand. The second is
# a first guess. Each makes the rule return to the flight level: level * 0.96 > (goal + turn) * 0.12 at 0.5 rad.
COSTS: dict[tuple[Reduction, Statistic], VFHWeights] = {
    ("truncated_icosahedron", "face"): VFHWeights(
        obstacle=19.6, goal=2.67, level=0.45, turn=0.388, width=4.44, nearness=2.17, caution=0.773
    ),
    ("truncated_icosahedron", "proximity"): VFHWeights(
        obstacle=3.0, goal=1.0, level=0.3, turn=0.2, width=6.0, nearness=2.0, caution=0.7
    ),
    ("range_image", "proximity"): VFHWeights(
        obstacle=1.0, goal=1.0, level=0.3, turn=0.2, width=6.0, nearness=2.0, caution=0.9, change=0.15
    ),
}


def _counting(cells: Tensor, width: float) -> Tensor:
    """How much of each of the cells that lie towards ``cells [cells, 3]`` counts in each direction: ``[D, cells]``."""
    return (DIRECTIONS @ cells.T).clamp_min(0) ** width


def blended(cost: Tensor, close: Tensor, goal: float, directions: Tensor) -> tuple[Tensor, Tensor]:
    """The best of the directions and those close to it, blended, so that it changes gradually as the costs do.

    Args:
        cost: of each direction, ``[N, D]``.
        close: which directions are blended with which, ``[D, D]``.
        goal: cost of a direction that leads away from the goal; the others are large or small beside it.
        directions: unit vectors ``[D, 3]``.

    Returns:
        The weights of the directions ``[N, D]``, and the unit vectors ``[N, 3]`` of the blend.

    Examples:
        >>> blended(torch.tensor([[0.0, 0.0, 9.0]]), torch.ones(3, 3) > 0, 1.0, torch.eye(3))[0].tolist()
        [[0.5, 0.5, 0.0]]
    """
    far = ~close[cost.argmin(-1)]
    weights = torch.softmax((-SHARPNESS / goal * cost).masked_fill(far, -math.inf), -1)
    return weights, torch.nn.functional.normalize(weights @ directions, dim=-1)


class VectorFieldHistogram(PolicyModule):
    """Flies where the reduced scan is emptiest on the way to the goal, slower the more stands there.

    Source: Borenstein and Koren (1991), The vector field histogram, in three dimensions and on the reduction's cells
    instead of a grid; Ulrich and Borenstein (1998), VFH+, for the cost of changing direction. Its only memory is the
    last action, where the observation holds that. With ``motion`` it also keeps out of the ways of moving objects, for
    two seconds, as if they flew straight on. With ``costs.headway`` the gaps to obstacles bound its speed, as in
    :class:`uavrl_onboard.guards.shield.Shield` (Faverjon and Tournassoud, 1987).

    Args:
        flight_level: altitude to hold where nothing is in the way, within 1 m, m.
        radius: of the reduction in m.
        reduction: which cells it sees, as in :class:`uavrl.transforms.NavigationState`.
        statistic: what a cell tells, likewise; None for the reduction's default.
        costs: None for those that were chosen for this reduction and statistic; there are none for some.
        last_action: whether the observation ends with the last action, likewise.
        motion: how far moving objects are looked for, likewise; None: it is not told of any.
        grid: where the cells of a range image are, likewise. Cells of another grid than the default's weigh so much
            that a scan that is full everywhere costs the same, for which the costs were chosen.
        max_speed: limit of each component of the velocity, m/s. Above 2 m/s a direction is flown so fast that the
            vehicle could stop before whatever a cell around it shows.
        airframe: whose hull it assumes; None for the default one.

    Examples:
        >>> from tensordict import TensorDict
        >>> faces = torch.zeros(1, 32)
        >>> state = TensorDict(
        ...     {"faces": faces, "heading_deg": torch.zeros(1, 1), "altitude": torch.full((1, 1), 3.5)}, [1]
        ... )
        >>> VectorFieldHistogram()(state)["action"].round(decimals=3).abs().tolist()
        [[2.0, 0.0, 0.0, 0.0]]
    """

    heading_key: ClassVar[str] = "heading_deg"
    """What it reads to head for the goal."""

    def __init__(
        self,
        flight_level: float = VEHICLE.flight_level,
        radius: float = 4.0,
        reduction: Reduction = "truncated_icosahedron",
        statistic: Statistic | None = None,
        costs: VFHWeights | None = None,
        last_action: bool = False,
        motion: float | None = None,
        grid: RangeGrid | None = None,
        max_speed: float = VEHICLE.velocity_limit,
        airframe: OrMapping[Airframe] | None = None,
    ) -> None:
        statistic = REDUCTIONS[reduction].default_statistic if statistic is None else statistic
        costs = self.default_costs(reduction, statistic) if costs is None else costs
        if costs is None:
            seen = " or ".join(" with ".join(pair) for pair in COSTS)
            raise UavrlError(
                f"vfh has costs for {seen}, and none for {reduction} with {statistic}: set perception.reduction and "
                "perception.statistic so, or give a demonstrator its demonstrator.costs."
            )
        if costs.headway and statistic != "proximity":
            raise UavrlError(
                f"costs.headway reads distances from cells of statistic=proximity, and these are of {statistic}: set "
                "perception.statistic=proximity, or leave costs out."
            )
        super().__init__()
        self.in_keys = ["faces", "altitude", self.heading_key, *(["observation"] if last_action else [])]
        self.in_keys += ["moving_objects", "velocity", "attitude"] if motion is not None else []
        self.out_keys = ["action"]
        self.evades = motion is not None
        self.vehicle = settings("airframe", Airframe, airframe).vehicle(flight_level, max_speed)
        self.radius, self.last_action = radius, last_action
        self.costs = costs
        self.directions: Tensor
        self._towards: Tensor  # [cells, 3]
        self._close: Tensor  # [D, D]: which directions are blended with which
        self._seen_in: Tensor  # [D, cells]: how much of each counts in a direction
        self.register_buffer("directions", DIRECTIONS.clone(), persistent=False)
        self.register_buffer("_close", DIRECTIONS @ DIRECTIONS.T > BLENDED, persistent=False)
        self.register_buffer("_towards", cell_directions(reduction, grid).clone(), persistent=False)
        seen_in = _counting(cell_directions(reduction, grid), self.costs.width)
        if reduction == "range_image" and grid not in (None, VLP16_GRID):
            known = _counting(cell_directions(reduction), self.costs.width)
            seen_in *= known.sum(-1, keepdim=True) / seen_in.sum(-1, keepdim=True)
        self.register_buffer("_seen_in", seen_in, persistent=False)
        self.nearness = statistic != "range"
        self._ahead: Tensor  # [D, cells]: 1 for the cells around a direction, and next to 0
        ahead = (DIRECTIONS @ cell_directions(reduction, grid).T > AHEAD).float().clamp_min(1e-3)
        self.register_buffer("_ahead", ahead, persistent=False)

    @staticmethod
    def default_costs(reduction: Reduction, statistic: Statistic) -> VFHWeights | None:
        """Return the costs that were chosen for a reduction and statistic; None if there are none."""
        return COSTS.get((reduction, statistic))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action`` from ``faces``, ``heading_deg`` and ``altitude``, and the ``observation``'s last action."""
        cost, speed = self.score_directions(tensordict)
        if self.evades:
            velocity = call_numpy(world_to_yaw, tensordict["velocity"], tensordict["attitude"][..., 2])
            cost, speed = call_numpy(evade, cost, speed, self.directions, velocity, *self.ways(tensordict))
        action = self.to_action(cost, speed, tensordict["heading_deg"])
        if self.costs.headway:
            velocity = call_numpy(keep_headway, action[..., :3], self._towards, self._allowed(tensordict))
            action = torch.cat([velocity, action[..., 3:]], -1)
        return tensordict.set("action", action)

    def _allowed(self, tensordict: TensorDictBase) -> Tensor:
        """How fast the vehicle may fly towards each cell, so that it keeps its headway: ``[N, cells]`` in m/s."""
        distance = self.radius - tensordict["faces"]
        gap = distance - (self.vehicle.radius + Shield.margin)
        if self.last_action:  # what is flown until the command acts
            flown = self.vehicle.velocity_limit * tensordict["observation"][..., -4:-1]
            gap = gap - LAG * (flown @ self._towards.T).clamp_min(0)
        seen = (tensordict["faces"] > 0) & (distance < sight_at(Shield.sight, self.vehicle.velocity_limit))
        speeds = call_numpy(closing_speeds, gap.clamp_min(0), self.costs.headway, self.vehicle.velocity_limit)
        return torch.where(seen, speeds, math.inf)

    def ways(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Where moving objects are thought to be, and which there are, as ``uavrl_onboard.guards.evade.evade`` asks."""
        ways, known = call_numpy(straight_on, tensordict["moving_objects"])
        return ways, known

    def score_directions(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """What each direction costs, and how fast it would be flown in m/s: ``[N, D]`` each."""
        costs, heading = self.costs, torch.deg2rad(tensordict["heading_deg"])  # [N, 1]
        x, y, z = self.directions.T
        in_the_way = (tensordict["faces"] / self.radius) ** costs.nearness @ self._seen_in.T
        off_level = (tensordict["altitude"] + NOMINAL * z - self.vehicle.flight_level).abs()
        cost = (
            costs.obstacle * in_the_way
            + costs.goal * (1 - x * heading.cos() - y * heading.sin())
            + costs.level * off_level
            + costs.turn * (1 - x)
        )
        if self.last_action:
            last = tensordict["observation"][..., -4:-1]  # forward, left, up, as a share of the largest
            size = last.norm(dim=-1, keepdim=True)
            cost += costs.change * (size > STANDING) * (1 - (last / size.clamp_min(STANDING)) @ self.directions.T)
        return cost, self._fastest(tensordict["faces"]) * (1 - costs.caution * in_the_way.clamp(0, 1))

    def _fastest(self, cells: Tensor) -> Tensor | float:
        """How fast each direction may be flown where nothing is in its way, m/s: ``[N, D]``, or the limit."""
        limit = self.vehicle.velocity_limit
        if limit <= NOMINAL:
            return limit
        near = self.radius - cells if self.nearness else torch.where(cells == 0, self.radius, cells)
        free = (near[:, None] / self._ahead).amin(-1) - self.vehicle.radius - CLEAR  # [N, D]
        reached = DECELERATION * ((REACTION**2 + 2 * free.clamp_min(0) / DECELERATION).sqrt() - REACTION)
        return reached.clamp(NOMINAL, limit)

    def to_action(self, cost: Tensor, speed: Tensor, heading_deg: Tensor) -> Tensor:
        """The action ``[N, 4]`` of the cheapest direction, of ``cost`` and ``speed [N, D]``, turning slowly to it.

        It is blended with its neighbours. Turning can be slow, since the vehicle flies to any side; a fast turn makes a
        late command point elsewhere.

        With the goal behind, at ``heading_deg [N, 1]``, it turns to the goal's side wherever it flies: ways past an
        obstacle there cost much the same to the left and to the right, and the better one changes from step to step.
        """
        weight, way = blended(cost, self._close, self.costs.goal, self.directions)
        turn = (TURN_GAIN * torch.atan2(way[:, 1:2], way[:, :1])).clamp(-TURN_LIMIT, TURN_LIMIT)
        right = heading_deg.remainder(360) - 180  # of straight behind, degrees; the goal's side is left below 0
        around = torch.where(right < 0, TURN_LIMIT, -TURN_LIMIT).to(turn)
        turn = torch.where(right.abs() < BEHIND, around, turn)
        return torch.cat([(weight * speed).sum(-1, keepdim=True) * way, turn], -1)
