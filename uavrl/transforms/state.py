"""From the raw scan to the policy's state, in one piece."""

from collections.abc import Iterator
from copy import deepcopy
from typing import Annotated, Any

import torch
from pydantic import Field
from torch import Tensor
from torch.nn.parameter import UninitializedBuffer
from torchrl.envs import CatFrames, CatTensors, Compose, ObservationNorm, Transform

from uavrl.errors import UavrlError
from uavrl.shown import Shown
from uavrl.transforms.icosahedron import TruncatedIcosahedron
from uavrl.transforms.motion import MovingObjects
from uavrl.transforms.observation import LastAction, NavigationObservation
from uavrl.transforms.range_image import RangeImage, range_image_directions
from uavrl.transforms.reduction import PointCloudReduction, Statistic
from uavrl.transforms.threats import Threats
from uavrl_onboard.perception.cells import FAR_EVERY, VLP16_GRID, RangeGrid
from uavrl_onboard.perception.motion.sight import scales
from uavrl_onboard.perception.observation import Angles
from uavrl_onboard.perception.reductions import Reduction
from uavrl_onboard.ranges import Positive
from uavrl_onboard.vehicle import VEHICLE

REDUCTIONS: dict[Reduction, type[PointCloudReduction]] = {
    "truncated_icosahedron": TruncatedIcosahedron,
    "range_image": RangeImage,
}
MOVING_OBJECTS = 3  # in an observation
ACTION_LIMIT = VEHICLE.velocity_limit  # m/s, and rad/s for the yaw rate (Table 4.1); a network reads it as 1


def make_reduction(reduction: Reduction, grid: RangeGrid | None = None, **options: Any) -> PointCloudReduction:
    """Returns a reduction by its name; ``grid`` is that of a range image.

    Raises:
        UavrlError: for an unknown name, and for a grid that the reduction does not have.
    """
    if reduction not in REDUCTIONS:
        raise UavrlError(f"reduction must be one of {', '.join(REDUCTIONS)}, got {reduction!r}.")
    if grid is None or grid == VLP16_GRID:
        return REDUCTIONS[reduction](**options)
    if reduction != "range_image":
        raise UavrlError(f"grid is that of reduction=range_image, and this is {reduction}: leave one of the two out.")
    return RangeImage(**vars(grid), **options)


def cell_directions(reduction: Reduction, grid: RangeGrid | None = None) -> Tensor:
    """Returns unit vectors ``[cells, 3]`` through the cells of a reduction; ``grid`` is that of a range image."""
    if grid is not None and reduction == "range_image":
        return range_image_directions(grid)
    return REDUCTIONS[reduction].directions()


def _with_last_action(max_speed: float) -> Iterator[Transform]:
    turn = VEHICLE.yaw_rate_limit  # which the vehicle takes, however fast it flies
    yield LastAction(limits=(*(max_speed,) * 3, turn) if max_speed > turn else None)
    yield ObservationNorm(loc=0.0, scale=1.0 / max_speed, in_keys=["last_action"])
    yield CatTensors(["observation", "last_action"], "observation", del_keys=True, sort=False)


def _with_motion(max_range: float, max_speed: float) -> Iterator[Transform]:
    scale = torch.tensor(scales(max_range), dtype=torch.float32).reciprocal()
    yield ObservationNorm(
        0.0,
        scale.repeat(MOVING_OBJECTS),
        in_keys=["moving_objects"],
        out_keys=["scaled_objects"],
        standard_normal=False,
    )
    yield Threats(max_speed)
    yield CatTensors(["observation", "scaled_objects", "threats"], "observation", del_keys=True, sort=False)


class Frames(CatFrames):
    """TorchRL's ``CatFrames`` that can also be copied before its first use, when its buffers have no shape yet."""

    def __deepcopy__(self, memo: dict[int, Any]) -> "Frames":
        """Return a copy; torch cannot copy a buffer without a shape, so such a buffer is made anew."""
        memo[id(self)] = copied = type(self).__new__(type(self))
        for buffer in self.buffers():
            if isinstance(buffer, UninitializedBuffer):
                memo[id(buffer)] = UninitializedBuffer(device=buffer.device, dtype=buffer.dtype)  # type: ignore[call-arg]
        copied.__setstate__(deepcopy(self.__getstate__(), memo))
        return copied


class NavigationState(Shown, Compose):
    """Everything between what :class:`uavrl.envs.NavigationEnv` emits and what a policy reads.

    The scan becomes 32 faces (or what another reduction makes of it), these with altitude and goal angles an
    observation, and ``frames`` of these, oldest first, the state (Chansuparp (2022), §3.2).

    Args:
        radius: the ball's radius, m.
        statistic: as in :class:`TruncatedIcosahedron`; None for the reduction's default.
        flight_level: the altitude at which an observation's altitude is 0, m.
        angles: as in :class:`NavigationObservation`.
        reduction: of the scan: ``"truncated_icosahedron"``, or the cells of a ``"range_image"``.
        grid: where the cells of a range image are; None for its 72 cells that fit a VLP-16.
        last_action: whether an observation also holds the action that led to it.
        motion: how far :class:`MovingObjects` are looked for, m, of which an observation then also holds the nearest
            three and their :class:`Threats`; the scan must reach as far. None: not at all.
        frames: observations in a state.
        max_speed: limit of each component of the velocity, m/s, which a network reads as 1.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from uavrl.envs import NavigationEnv
        >>> from uavrl.envs.lidar import LidarConfig
        >>> base = NavigationEnv(2, lidar=LidarConfig(max_range=4.0))  # the ball's radius: no need to look farther
        >>> env = TransformedEnv(base, NavigationState())
        >>> env.reset()["observation"].shape
        torch.Size([2, 105])
    """

    def __init__(
        self,
        radius: Annotated[float, Field(gt=0, le=100)] = 4.0,
        statistic: Statistic | None = None,
        flight_level: Positive = VEHICLE.flight_level,
        angles: Angles = "folded",
        frames: Annotated[int, Field(ge=1, le=1000)] = 3,
        *,
        reduction: Reduction = "truncated_icosahedron",
        grid: RangeGrid | None = None,
        last_action: bool = False,
        motion: Annotated[float, Field(gt=0, le=1000)] | None = None,
        max_speed: Positive = VEHICLE.velocity_limit,
    ) -> None:
        reduced = make_reduction(reduction, grid, radius=radius, statistic=statistic)
        self.max_speed = float(max_speed)
        super().__init__(
            *([MovingObjects(motion, MOVING_OBJECTS, FAR_EVERY)] if motion is not None else ()),
            reduced,
            NavigationObservation(radius, flight_level, angles),
            *(_with_motion(motion, max_speed) if motion is not None else ()),
            *(_with_last_action(max_speed) if last_action else ()),
            Frames(frames, dim=-1, in_keys=["observation"], padding="constant", padding_value=0.0),
        )
