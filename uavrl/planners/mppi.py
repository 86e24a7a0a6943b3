"""Model predictive path integral control, a sampling MPC: a rival of what is learned."""

from dataclasses import dataclass
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor

from uavrl.envs.limits import OrMapping
from uavrl.envs.quadrotor import Airframe
from uavrl.planners.point_memory import GAIN, LEAN, PERIOD, Planner, Surroundings
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl_onboard.geometry import hull_distances, off_altitudes
from uavrl_onboard.perception.motion.threats import GREATEST, threat
from uavrl_onboard.ranges import Positive, Seed
from uavrl_onboard.vehicle import VEHICLE

STEPS, EVERY = 20, 2  # of 0.1 s that are looked ahead, and which of them obstacles are looked for in
KNOTS = 5  # times between which the noise of a sample is interpolated: commands change gradually
BANK = 8  # sets of samples that take turns
HARDEST = 5.4  # m/s², level: that of the largest tilt
LEAST_CLIMB = 0.3  # m/s that it may always climb or sink


@dataclass(frozen=True)
class MPPIWeights:
    """What a path costs an :class:`MPPI`, and how it samples.

    The numbers are, rounded, the best of 24 settings that ``python studies/tune_rivals.py mppi`` flew in valleys 200 to
    209: 46 of 48 tasks, 86 steps each; 44 with the next, 154 steps. The first guesses had 43, 106 steps.
    """

    collision: float = 46.0  #: cost of a path that collides at once; less, the later
    obstacle: float = 0.85  #: cost of a path that is ever about to touch something
    goal: float = 1.0  #: cost of a metre that is not gained on the way to the goal
    across: float = 0.24  #: cost of a metre to either side of the way to the goal
    level: float = 0.12  #: cost of a metre off the flight level
    outside: float = 10.0  #: cost of a metre beyond the altitudes in which one may fly
    effort: float = 0.28  #: gamma / lambda, cost of samples away from 0 along the plan
    near: float = 0.06  #: m that are kept between hull and obstacle
    far: float = 0.62  #: m between hull and obstacle from which on it costs nothing
    speed: float = 2.6  #: m/s on the level, at most
    climb: float = 0.43  #: m/s up or down for each m/s on the level, at most
    spread: float = 1.3  #: sigma, m/s
    temperature: float = 0.44  #: lambda


def places_of(commands: Tensor, velocity: Tensor, acceleration: Tensor) -> Tensor:
    """Where commanded velocities ``[*B, T, 3]`` lead to from here, ``[*B, T, 3]`` m.

    A velocity that differs from its command asks for an acceleration, which comes with the vehicle's tilt: late, and
    within what the tilt allows. A command is held for a step.

    Args:
        commands: in m/s.
        velocity: of now, ``[*B, 3]``.
        acceleration: likewise, in m/s².

    Examples:
        >>> steady = torch.tensor([2.0, 0.0, 0.0])
        >>> places_of(steady.expand(STEPS, 3), steady, torch.zeros(3))[-1].round(decimals=3)  # m after 2 s at 2 m/s
        tensor([4., 0., 0.])
    """
    place, places = torch.zeros_like(commands[..., 0, :]), []
    for command in commands.unbind(-2):
        asked = GAIN * (command - velocity)
        asked = asked / (asked[..., :2].norm(dim=-1, keepdim=True) / HARDEST).clamp_min(1)
        acceleration = acceleration + LEAN * (asked - acceleration)
        place = place + PERIOD * velocity + PERIOD**2 / 2 * acceleration
        velocity = velocity + PERIOD * acceleration
        places.append(place)
    return torch.stack(places, -2)


def limited(commands: Tensor, speed: float, climb: float) -> Tensor:
    """Commands ``[*B, 3]`` at most at ``speed`` m/s on the level, and as steep as is seen: a LiDAR sees 15 degrees up.

    Examples:
        >>> limited(torch.tensor([[3.0, 0.0, 2.0], [0.0, 0.0, -2.0]]), 2.0, 0.5)
        tensor([[ 2.0000,  0.0000,  1.0000],
                [ 0.0000,  0.0000, -0.3000]])
    """
    level = commands[..., :2]
    level = level / (level.norm(dim=-1, keepdim=True) / speed).clamp_min(1)
    steepest = (climb * level.norm(dim=-1, keepdim=True)).clamp_min(LEAST_CLIMB)
    return torch.cat([level, commands[..., 2:].clamp(-steepest, steepest)], -1)


def interpolated(noise: Tensor) -> Tensor:
    """Noise ``[*B, KNOTS, 3]`` at all steps, ``[*B, T, 3]``, straight from knot to knot."""
    at = torch.linspace(0, KNOTS - 1, STEPS, dtype=torch.float32)
    share = (1 - (at[:, None] - torch.arange(KNOTS)).abs()).clamp_min(0)  # [T, KNOTS]
    return share @ noise


class MPPI(Planner):
    """Samples plans of two seconds around the last one, and flies the first step of their weighted mean.

    A sample weighs the more, the less its path costs: what is gained towards the goal, how near it comes to the
    obstacles of the last seconds, its height.

    Source: Williams, Wagener, Goldfain, Drews, Rehg, Boots and Theodorou (2017), Information theoretic MPC for
    model-based reinforcement learning, Algorithm 2; samples that change gradually take the place of its smoothing. It
    knows no distance to the goal, only its direction, as the policies do. It does not turn: it flies to any side. A
    path that comes near a moving object costs like a collision, the nearer and sooner the more.

    Vehicles of one age share their samples, so that an episode does not depend on what flies beside it.

    Args:
        flight_level: altitude to hold where nothing is in the way, m.
        radius: how far it sees, m; what lies farther is not used.
        seconds: for which obstacles are remembered.
        motion: how far moving objects are looked for, as in :class:`uavrl.transforms.NavigationState`; None: what moves
            is taken for standing.
        samples: plans that are tried in each step.
        seed: of the samples.
        costs: None for the ones above.
        airframe: whose hull and LiDAR it reckons with; None for the default one.
        max_speed: limit of each component of the velocity, m/s.

    Examples:
        >>> from tensordict import TensorDict
        >>> seen = {"point_cloud": torch.full((1, 16, 3), torch.nan), "altitude": torch.full((1, 1), 3.5)}
        >>> still = {"velocity": torch.zeros(1, 3), "attitude": torch.zeros(1, 3), "heading_deg": torch.zeros(1, 1)}
        >>> state = TensorDict({**seen, **still, "is_init": torch.ones(1, 1, dtype=bool)}, [1])
        >>> bool(MPPI()(state)["action"][0, 0] > 0)  # ahead, to the goal
        True
    """

    def __init__(
        self,
        flight_level: float = VEHICLE.flight_level,
        radius: Annotated[float, Field(gt=0, le=100)] = 4.0,
        *,
        seconds: Positive = 2.0,
        motion: float | None = None,
        samples: Annotated[int, Field(ge=2, le=100_000)] = 256,
        seed: Seed = 0,
        costs: MPPIWeights | None = None,
        airframe: OrMapping[Airframe] | None = None,
        max_speed: float = VEHICLE.velocity_limit,
    ) -> None:
        super().__init__(flight_level, radius, seconds, motion, airframe, max_speed=max_speed)
        self.costs = MPPIWeights() if costs is None else costs
        generator = torch.Generator().manual_seed(seed)
        noise = torch.randn(BANK, samples, KNOTS, 3, generator=generator, dtype=torch.float32)
        noise[:, 0] = 0.0  # the plan itself
        self._noise = interpolated(noise) * self.costs.spread
        self._plans, self._ages = torch.zeros(0, STEPS, 3, dtype=torch.float32), torch.zeros(0, dtype=torch.long)

    def steer(self, seen: Surroundings) -> tuple[Tensor, Tensor]:
        """The first velocities of plans that are better than the last ones, and yaw rates of 0."""
        count = len(seen.fresh)
        if len(self._plans) != count:
            self._plans = torch.zeros(count, STEPS, 3, dtype=torch.float32)
            self._ages = torch.zeros(count, dtype=torch.long)
        self._plans[seen.fresh[:, 0]] = 0.0
        self._ages = torch.where(seen.fresh[:, 0], 0, self._ages + 1)
        plans = self._improved(seen)
        self._plans = torch.cat([plans[:, 1:], plans[:, -1:]], 1)
        return plans[:, 0], plans.new_zeros(count, 1)

    def evade(self, velocity: Tensor, seen: Surroundings) -> Tensor:
        """The same velocities: the plans keep out of the ways of what moves already."""
        return velocity

    def _improved(self, seen: Surroundings) -> Tensor:
        """The next plans, ``[N, T, 3]`` m/s."""
        costs, plans = self.costs, self._plans[:, None]
        tried = plans + self._noise[self._ages % BANK]  # [N, K, T, 3]
        tried[:, 1] = 0.0  # to stop
        fastest = costs.speed * self.vehicle.velocity_limit / VEHICLE.velocity_limit
        noise = limited(tried, fastest, costs.climb) - plans
        places = places_of(plans + noise, seen.velocity[:, None], seen.acceleration[:, None])
        effort = costs.effort * costs.temperature / costs.spread**2 * (plans * noise).mean(2).sum(-1)
        weight = torch.softmax(-(self._cost(places, seen) + effort) / costs.temperature, -1)
        return self._plans + torch.einsum("nk,nktd->ntd", weight, noise)

    def _cost(self, places: Tensor, seen: Surroundings) -> Tensor:
        """What paths ``[N, K, T, 3]`` cost, ``[N, K]``."""
        costs, goal = self.costs, seen.goal[:, None]
        off = seen.altitude[..., None] + places[..., 2] - self.vehicle.flight_level
        looked = zip(seen.points, places[:, :, EVERY - 1 :: EVERY], strict=True)
        hull = self.vehicle.hull
        distances = [call_numpy(hull_distances, points, path, costs.near, hull) for points, path in looked]
        beside = torch.stack(distances)  # [N, K, T / 2]
        nearness = ((costs.far - beside) / (costs.far - costs.near)).clamp(0, 1).amax(-1)
        gained = (places[:, :, -1] * goal).sum(-1)  # m
        collided = (beside < costs.near).cummax(-1).values.to(places)  # once it has, it has
        return (
            costs.collision * (collided.mean(-1) + self._met(places, seen))
            + costs.obstacle * nearness
            - costs.goal * gained
            + costs.across * (places[:, :, -1] - gained[..., None] * goal)[..., :2].norm(dim=-1)
            + costs.level * off.abs().mean(-1)
            + costs.outside * call_numpy(off_altitudes, off, self.vehicle).amax(-1)
        )

    def _met(self, places: Tensor, seen: Surroundings) -> Tensor | float:
        """How near and how soon paths ``[N, K, T, 3]`` come to what moves, ``[N, K]`` from 0 to 1."""
        if not seen.known.any():
            return 0.0
        threats = call_numpy(threat, places[:, :, None] - seen.ways[:, None]) * seen.known[:, None]  # [N, K, bodies]
        return threats.amax(-1) / GREATEST
