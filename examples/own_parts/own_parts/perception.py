"""Eight sectors around the vehicle in place of 32 faces."""

import math

import torch
from torch import Tensor
from torchrl.envs import CatFrames, Compose

from uavrl.transforms import NavigationObservation, PointCloudReduction
from uavrl.transforms.reduction import is_return
from uavrl_onboard.ranges import Count, Positive

SECTORS = 8


def sectors(points: Tensor, radius: float, statistic: str) -> Tensor:
    """How near the nearest point of each sector is: clouds ``[*B, P, 3]`` in m to ``[*B, 8]``, 0 for nothing."""
    azimuth = torch.atan2(points[..., 1], points[..., 0]).nan_to_num()
    sector = (azimuth * SECTORS / math.tau).round().long().remainder(SECTORS)
    distance = points.norm(dim=-1).where(is_return(points, radius), radius)
    nearest = points.new_full((*points.shape[:-2], SECTORS), radius).scatter_reduce(-1, sector, distance, "amin")
    return radius - nearest


class Sectors(PointCloudReduction):
    """The reduction as a transform: a function, and where its cells are."""

    default_statistic = "proximity"  # the nearer, the greater: how a replay colours the cells
    reduced = staticmethod(sectors)

    @staticmethod
    def directions() -> Tensor:
        """Unit vectors ``[8, 3]`` through the sectors, forward first."""
        azimuth = torch.arange(SECTORS) * (math.tau / SECTORS)
        return torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros(SECTORS)], -1)


class SectorState(Compose):
    """Everything between what the valley emits and what a policy reads."""

    def __init__(self, radius: Positive = 4.0, flight_level: Positive = 3.5, frames: Count = 3) -> None:
        super().__init__(
            Sectors(radius=radius),
            NavigationObservation(radius, flight_level),
            CatFrames(frames, dim=-1, in_keys=["observation"], padding="constant", padding_value=0.0),
        )
