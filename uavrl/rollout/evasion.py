"""What flying in a direction costs where something else will pass, and how fast it is best flown."""

import torch
from torch import Tensor

from uavrl.motion.threats import greatest_threats, predict_path
from uavrl.rollout.hull import HULL, Hull, hull_distances, off_altitudes
from uavrl.transforms.state import ACTION_LIMIT
from uavrl.transforms.threats import DIRECTIONS

SHARES = torch.tensor([1.0, 0.5, 0.0])  # of the speed that a direction would be flown at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand
NEAR, FAR = 0.15, 0.6  # m between hull and obstacle: a collision, and where it begins to cost, by hand, too
SOON = 10  # steps of 0.1 s in which that is looked for
OUTSIDE = 10.0  # cost of a metre beyond the altitudes in which one may fly
OTHERS = torch.cat([(ACTION_LIMIT * SHARES[:-1, None, None] * DIRECTIONS).flatten(0, 1), torch.zeros(1, 3)])


def evade(
    cost: Tensor, speed: Tensor, directions: Tensor, velocity: Tensor, ways: Tensor, known: Tensor
) -> tuple[Tensor, Tensor]:
    """What each direction costs with the threats on it, and how fast it is then best flown: ``[N, D]`` each.

    Args:
        cost: of each direction without threats, ``[N, D]``.
        speed: at which each would be flown in m/s, likewise.
        directions: ``[D, 3]``, in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m.
        known: which of them there are, ``bool [N, K]``.
    """
    shares = SHARES.to(speed)
    commanded = speed[..., None, None] * shares[:, None] * directions[:, None]  # [N, D, S, 3]
    worst = greatest_threats(commanded, velocity, ways, known)
    least, share = (cost[..., None] + SLOWNESS * (1 - shares) + THREAT * worst).min(-1)
    return least, shares[share] * speed


def evaded(
    planned: Tensor,
    velocity: Tensor,
    ways: Tensor,
    known: Tensor,
    points: list[Tensor],
    height: Tensor,
    hull: Hull = HULL,
) -> Tensor:
    """Planned velocities ``[N, 3]`` in m/s, and in place of one that leads to a moving body the best of some others.

    Each other one costs its difference to the planned one, the moving bodies on it, and what stands near it. This is a
    reactive law beside a planner, for bodies that fly straight on.

    Args:
        planned: in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m.
        known: which of them there are, ``bool [N, K]``.
        points: of each vehicle the obstacles around it, ``[P, 3]`` m.
        height: of the vehicles over the flight level, ``[N, 1]`` m.
        hull: its radius, and half its height, m.

    Examples:
        A body comes straight ahead, at 3 m/s from 6 m away. The vehicle, which would fly at 2 m/s, gives way:

        >>> ahead = torch.tensor([[2.0, 0.0, 0.0]])
        >>> ways = torch.stack([6 - 0.3 * torch.arange(1, 21), torch.zeros(20), torch.zeros(20)], -1)[None, None]
        >>> around = ([torch.zeros(0, 3)], torch.zeros(1, 1))
        >>> bool(evaded(ahead, ahead, ways, torch.tensor([[True]]), *around)[0, 1:].norm() > 0.5)
        True
        >>> evaded(ahead, ahead, ways, torch.tensor([[False]]), *around).tolist()
        [[2.0, 0.0, 0.0]]
    """
    worst = greatest_threats(planned, velocity, ways, known)
    flown = planned.clone()
    for one in worst.nonzero()[:, 0].tolist():
        tried = torch.cat([planned[one, None], OTHERS])[None]  # [1, C, 3]
        own = slice(one, one + 1)
        path = predict_path(tried, velocity[own, None])[0, :, :SOON]  # [C, T, 3]
        beside = hull_distances(points[one], path, NEAR, hull)
        off = off_altitudes(height[one] + path[..., 2]).amax(-1)
        stands = ((FAR - beside) / (FAR - NEAR)).clamp(0, 1).amax(-1) + (beside < NEAR).any(-1)
        threats = greatest_threats(tried, velocity[own], ways[own], known[own])[0]
        cost = (tried[0] - planned[one]).norm(dim=-1) / ACTION_LIMIT + THREAT * (threats + stands) + OUTSIDE * off
        flown[one] = tried[0, cost.argmin()]
    return flown
