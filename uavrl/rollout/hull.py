"""How near a vehicle's hull comes to what is around it, and how high it may fly."""

import math

import torch
from torch import Tensor

from uavrl.mapping.route import HULL

LOWEST, HIGHEST = -2.3, 0.7  # m from the flight level, between which one may fly

Hull = tuple[float, float]  # m: the radius, and half the height


def stretch(near: float, hull: Hull = HULL) -> Tensor:
    """Factors ``[3]`` by which the flat hull, with ``near`` metres kept all around it, becomes as high as wide.

    Examples:
        >>> (0.14 + 0.15) * stretch(0.15)[2].round(decimals=3)  # the hull's radius, and 0.15 m
        tensor(0.5000)
    """
    return torch.tensor([1.0, 1.0, (hull[0] + near) / (hull[1] + near)])


def hull_distances(points: Tensor, places: Tensor, near: float, hull: Hull = HULL) -> Tensor:
    """How far the hull is from its nearest obstacle ``[*B]`` m at ``places [*B, 3]``, of ``points [P, 3]``.

    Heights are stretched until the hull, with ``near`` metres around it, is as high as wide.

    Examples:
        >>> hull_distances(torch.tensor([[1.35, 0.0, 0.0]]), torch.zeros(1, 3), 0.15)
        tensor([1.])
    """
    if not len(points):
        return torch.full(places.shape[:-1], math.inf)
    points, flat = points * stretch(near, hull), places.reshape(-1, 3) * stretch(near, hull)
    apart = (flat @ points.T).mul_(-2).add_((points * points).sum(-1))
    least = apart.amin(-1) + (flat * flat).sum(-1)
    return (least.clamp_min(0).sqrt() - hull[0]).reshape(places.shape[:-1])


def off_altitudes(off: Tensor) -> Tensor:
    """How far heights ``off`` the flight level, in m, lie out of where one may fly: below the ceiling, off the ground.

    Examples:
        >>> off_altitudes(torch.tensor([0.0, 1.0, -3.0]))
        tensor([0.0000, 0.3000, 0.7000])
    """
    return (LOWEST - off).clamp_min(0) + (off - HIGHEST).clamp_min(0)
