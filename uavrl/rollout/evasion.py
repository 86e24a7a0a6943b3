"""What flying in a direction costs where something else will pass, and how fast it is best flown."""

import torch
from torch import Tensor

from uavrl.motion.threats import greatest_threats

SHARES = torch.tensor([1.0, 0.5, 0.0])  # of the speed that a direction would be flown at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand


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
