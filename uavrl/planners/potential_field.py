"""Attraction and repulsion: the simplest rival of what is learned."""

from dataclasses import dataclass
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor

from uavrl.envs.limits import OrMapping
from uavrl.envs.quadrotor import Airframe
from uavrl.planners.point_memory import Planner, Surroundings
from uavrl_onboard.ranges import Positive
from uavrl_onboard.vehicle import VEHICLE

SECTORS = 12  # around the vehicle; in each the nearest point pushes


@dataclass(frozen=True)
class FieldWeights:
    """How strongly a :class:`PotentialField` pulls and pushes.

    The numbers are, rounded, the best of 24 settings that ``python studies/tune_rivals.py potential_field`` flew in
    valleys 200 to 209: 38 of 48 tasks. The next ones had 37 and 35.
    """

    attraction: float = 2.4  #: m/s towards the goal
    repulsion: float = 0.027  #: eta, m³/s
    reach: float = 0.96  #: rho_0, m between hull and obstacle from which on nothing pushes
    level: float = 0.4  #: 1/s, vertical speed for each metre off the flight level


def repulsion(points: Tensor, reach: float, radius: float = VEHICLE.radius) -> Tensor:
    """The push ``[3]`` of the obstacles around one vehicle for eta = 1.

    Source: Khatib (1986), Real-time obstacle avoidance for manipulators and mobile robots, FIRAS: each pushes by
    (1/rho - 1/rho_0) / rho² straight away from its nearest point, where that is nearer than rho_0. Here rho is the
    distance from the hull, at least 0.05 m, and what lies in one of 12 sectors around the vehicle is one obstacle.

    Args:
        points: obstacles, ``[P, 3]``, m from the vehicle.
        reach: rho_0 in m.
        radius: of the hull, m.

    Examples:
        >>> repulsion(torch.tensor([[1.35, 0.0, 0.0], [1.5, 0.0, 0.0], [9.0, 0.0, 0.0]]), 2.0)[0].round(decimals=3)
        tensor(-0.5000)
    """
    distances = points.norm(dim=-1)
    sector = ((torch.atan2(points[:, 1], points[:, 0]) / (2 * torch.pi) + 0.5) * SECTORS).long().clamp_max(SECTORS - 1)
    least = distances.new_full((SECTORS,), torch.inf).scatter_reduce(0, sector, distances, "amin")
    points, distances = points[distances == least[sector]], distances[distances == least[sector]]
    rho = (distances - radius).clamp_min(0.05)
    push = (1 / rho - 1 / reach).clamp_min(0) / (rho * rho)
    return -(push / distances.clamp_min(1e-6)) @ points


class PotentialField(Planner):
    """Is drawn to the goal and pushed away from what it has just seen: Khatib's law, with velocities for forces.

    Source: Khatib (1986). The pull has one strength, as the distance to the goal is not known. The push is that of the
    place to which its own speed carries it. Where pull and push cancel each other it stands, and nothing leads it away.

    Args:
        flight_level: altitude to hold, m.
        radius: how far it sees, m.
        seconds: for which obstacles are remembered.
        motion: how far moving objects are looked for, as in :class:`uavrl.transforms.NavigationState`, to keep out of
            their ways; None: what moves is taken for standing.
        costs: None for the ones above.
        airframe: whose hull and LiDAR it reckons with; None for the default one.
        max_speed: limit of each component of the velocity, m/s.

    Examples:
        >>> from tensordict import TensorDict
        >>> seen = {"point_cloud": torch.full((1, 16, 3), torch.nan), "altitude": torch.full((1, 1), 3.5)}
        >>> still = {"velocity": torch.zeros(1, 3), "attitude": torch.zeros(1, 3), "heading_deg": torch.zeros(1, 1)}
        >>> state = TensorDict({**seen, **still, "is_init": torch.ones(1, 1, dtype=bool)}, [1])
        >>> PotentialField()(state)["action"].tolist()
        [[2.0, 0.0, 0.0, 0.0]]
    """

    def __init__(
        self,
        flight_level: float = VEHICLE.flight_level,
        radius: Annotated[float, Field(gt=0, le=100)] = 4.0,
        *,
        seconds: Positive = 0.5,
        motion: float | None = None,
        costs: FieldWeights | None = None,
        airframe: OrMapping[Airframe] | None = None,
        max_speed: float = VEHICLE.velocity_limit,
    ) -> None:
        super().__init__(flight_level, radius, seconds, motion, airframe, max_speed=max_speed)
        self.costs = FieldWeights() if costs is None else costs

    def steer(self, seen: Surroundings) -> tuple[Tensor, Tensor]:
        """The sums of pull and push, and yaw rates to the goal."""
        costs = self.costs
        around = zip(seen.points, seen.carried, strict=True)
        push = torch.stack([repulsion(points - place, costs.reach, self.vehicle.radius) for points, place in around])
        velocity = costs.attraction * seen.goal + costs.repulsion * push
        velocity[:, 2:] += costs.level * (self.vehicle.flight_level - seen.altitude)
        fastest = (
            velocity.norm(dim=-1, keepdim=True).clamp_min(self.vehicle.velocity_limit) / self.vehicle.velocity_limit
        )
        return velocity / fastest, seen.turn
