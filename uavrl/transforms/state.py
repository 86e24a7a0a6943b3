"""From the raw scan to the policy's state, in one piece."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import torch
from pydantic import Field
from torchrl.envs import CatFrames, CatTensors, Compose, ObservationNorm, Transform

from uavrl.transforms.icosahedron import TruncatedIcosahedron
from uavrl.transforms.motion import MovingObjects
from uavrl.transforms.observation import Angles, LastAction, NavigationObservation
from uavrl.transforms.range_image import RangeImage
from uavrl.transforms.reduction import PointCloudReduction, Statistic
from uavrl.transforms.threats import Threats
from uavrl.transforms.waypoint import Waypoint
from uavrl_onboard.perception.cells import FAR_EVERY
from uavrl_onboard.perception.motion.sight import scales
from uavrl_onboard.ranges import Positive
from uavrl_onboard.vehicle import VEHICLE

Reduction = Literal["truncated_icosahedron", "range_image"]
REDUCTIONS: dict[Reduction, type[PointCloudReduction]] = {
    "truncated_icosahedron": TruncatedIcosahedron,
    "range_image": RangeImage,
}
MOVING_OBJECTS = 3  # in an observation
ACTION_LIMIT = VEHICLE.velocity_limit  # m/s, and rad/s for the yaw rate (Table 4.1); a network reads it as 1


def _with_last_action() -> Iterator[Transform]:
    yield LastAction()
    yield ObservationNorm(loc=0.0, scale=1.0 / ACTION_LIMIT, in_keys=["last_action"])
    yield CatTensors(["observation", "last_action"], "observation", del_keys=True, sort=False)


def _with_motion(max_range: float) -> Iterator[Transform]:
    scale = torch.tensor(scales(max_range)).reciprocal()
    yield ObservationNorm(
        0.0,
        scale.repeat(MOVING_OBJECTS),
        in_keys=["moving_objects"],
        out_keys=["scaled_objects"],
        standard_normal=False,
    )
    yield Threats(ACTION_LIMIT)
    yield CatTensors(["observation", "scaled_objects", "threats"], "observation", del_keys=True, sort=False)


class NavigationState(Compose):
    """Everything between what :class:`uavrl.envs.NavigationEnv` emits and what a policy reads.

    The scan becomes 32 faces (or what another reduction makes of it), these with altitude and goal angles an
    observation, and ``frames`` of these, oldest first, the state (Chansuparp (2022), §3.2).

    Args:
        radius: the ball's radius, m.
        statistic: as in :class:`TruncatedIcosahedron`; None for the reduction's default.
        flight_level: the altitude at which an observation's altitude is 0, m.
        angles: as in :class:`NavigationObservation`.
        reduction: of the scan: ``"truncated_icosahedron"``, or the 72 cells of a ``"range_image"``.
        last_action: whether an observation also holds the action that led to it.
        motion: how far :class:`MovingObjects` are looked for, m, of which an observation then also holds the nearest
            three and their :class:`Threats`; the scan must reach as far. None: not at all.
        memory: how far a map of the episode looks, m, through which the next :class:`Waypoint` is found; the heading in
            an observation is then that to the waypoint, and the scan must reach as far. None: that to the goal.
        frames: observations in a state.
        sensor_position: of the LiDAR in body axes, m, by which the map knows how high a return is; 0.1 m above the
            hull's middle by default.

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
        last_action: bool = False,
        motion: Annotated[float, Field(gt=0, le=1000)] | None = None,
        memory: Annotated[float, Field(gt=0, le=40)] | None = None,
        sensor_position: Sequence[float] = VEHICLE.lidar_position,
    ) -> None:
        if reduction not in REDUCTIONS:
            raise ValueError(f"reduction must be one of {', '.join(REDUCTIONS)}, got {reduction!r}.")
        heading = "heading_deg" if memory is None else "waypoint_deg"
        super().__init__(
            *(() if memory is None else [Waypoint(memory, flight_level=flight_level, sensor_position=sensor_position)]),
            *([MovingObjects(motion, MOVING_OBJECTS, FAR_EVERY)] if motion is not None else ()),
            REDUCTIONS[reduction](radius=radius, statistic=statistic),
            NavigationObservation(
                radius, flight_level, angles, in_keys=("faces", "altitude", heading, "elevation_deg")
            ),
            *(_with_motion(motion) if motion is not None else ()),
            *(_with_last_action() if last_action else ()),
            CatFrames(frames, dim=-1, in_keys=["observation"], padding="constant", padding_value=0.0),
        )
