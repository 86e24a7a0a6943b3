"""What flying in a direction costs where something else will pass, and how fast it is best flown."""

import torch
from torch import Tensor

from uavrl.transforms.motion import OBJECT

STEPS, PERIOD = 20, 0.1  # that are looked ahead, in s each: two seconds
TIMES = torch.arange(1, STEPS + 1) * PERIOD
SHARES = torch.tensor([1.0, 0.5, 0.0])  # of the speed that a direction would be flown at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand
LAG = 0.4  # s, until a commanded velocity is nearly flown
WIDE = 1.45  # m: 0.6 of wing, 0.35 of hull, 0.5 between
HIGH = 0.6  # m: 0.27 of fin, 0.14 of hull, 0.19 between


def predict_path(commanded: Tensor, velocity: Tensor) -> Tensor:
    """Where a vehicle will be ``[*B, T, 3]`` from here: its velocity follows the commanded one with a first-order lag.

    Args:
        commanded: velocities ``[*B, 3]`` in m/s.
        velocity: what it has now, likewise.

    Examples:
        >>> predict_path(torch.tensor([2.0, 0.0, 0.0]), torch.tensor([2.0, 0.0, 0.0]))[-1].tolist()
        [4.0, 0.0, 0.0]
    """
    lost = LAG * (1 - torch.exp(-TIMES / LAG))
    return commanded[..., None, :] * (TIMES - lost)[:, None] + velocity[..., None, :] * lost[:, None]


def threat(gap: Tensor) -> Tensor:
    """How near one comes to a body and how soon ``[*B]``, of what lies between ``[*B, T, 3]``; 0 is far.

    Examples:
        >>> threat(torch.full((STEPS, 3), 9.0)).item()
        0.0
    """
    apart = torch.maximum(gap[..., :2].norm(dim=-1) / WIDE, gap[..., 2].abs() / HIGH)  # below 1: too near
    share = TIMES / TIMES[-1]
    soon = (1.2 - 0.2 * share - apart).clamp_min(0) * (1 - 0.5 * share)
    return soon.amax(-1) + (apart < 1).any(-1).to(gap)


def straight_on(objects: Tensor) -> tuple[Tensor, Tensor]:
    """The ways ``[N, K, T, 3]`` of moving objects ``[N, K * 7]``, and which of them there are, ``bool [N, K]``.

    The objects are :class:`uavrl.transforms.MovingObjects`.
    """
    each = objects.unflatten(-1, (-1, len(OBJECT)))
    ways = each[..., None, :3] + each[..., None, 3:6] * TIMES[:, None]
    return ways, each[..., -1] > 0


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
    worst = torch.zeros(*cost.shape, len(SHARES))
    for body in range(known.shape[-1]):
        which = known[:, body].nonzero()[:, 0]
        if len(which):
            commanded = speed[which, :, None, None] * SHARES[:, None] * directions[:, None]  # [M, D, S, 3]
            gap = predict_path(commanded, velocity[which, None, None]) - ways[which, body, None, None]
            worst[which] = torch.maximum(worst[which], threat(gap))
    least, share = (cost[..., None] + SLOWNESS * (1 - SHARES) + THREAT * worst).min(-1)
    return least, SHARES[share] * speed


def to_yaw(vectors: Tensor, yaw: Tensor) -> Tensor:
    """Turns vectors ``[N, ..., 3]`` from world axes into those of yaws ``[N]`` in rad.

    Examples:
        >>> to_yaw(torch.tensor([[0.0, 2.0, 1.0]]), torch.tensor([torch.pi / 2])).round(decimals=3).tolist()
        [[2.0, -0.0, 1.0]]
    """
    yaw = yaw.reshape(-1, *[1] * (vectors.ndim - 2))
    x, y, z = vectors.unbind(-1)
    return torch.stack([yaw.cos() * x + yaw.sin() * y, yaw.cos() * y - yaw.sin() * x, z], -1)
