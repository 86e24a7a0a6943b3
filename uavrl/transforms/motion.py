"""What moves around a LiDAR (:mod:`uavrl_onboard.perception.motion`) as a transform of TorchRL."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded

from uavrl.entries import entry, entry_spec
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl.transforms.through_time import ThroughTime
from uavrl_onboard.geometry import Columns, is_return
from uavrl_onboard.perception.cells import LASERS
from uavrl_onboard.perception.motion import OBJECT, MotionSight
from uavrl_onboard.perception.motion.rays import ScanPattern
from uavrl_onboard.vehicle import VEHICLE

__all__ = ["OBJECT", "MotionSight", "MovingObjects"]


def searched_alone(clouds: np.ndarray, pattern: ScanPattern) -> np.ndarray:
    """Returns the points of clouds ``[N, P, 3]`` that are searched for motion, and then NaN, in the same shape."""
    found = np.full_like(clouds, np.nan)
    for cloud, kept in zip(clouds, found, strict=True):
        at = np.flatnonzero(is_return(cloud)).take(pattern.searched(Columns.of(cloud)))
        kept[: len(at)] = cloud[at]
    return found


class MovingObjects(ThroughTime):
    """Writes where the nearest moving objects are and how they fly, by what the last scans saw through.

    See :class:`MotionSight` for how. It needs what an autopilot knows of itself: velocity and attitude. The objects are
    seen through a LiDAR that must reach as far as is looked. They are found while episodes run, on the CPU, and not in
    stored data. Vehicles whose episodes begin have seen nothing yet.

    Args:
        max_range: how far is looked, m.
        objects: K that are reported.
        every: of the points, only those of every such firing cycle of 16 count, which the sensor must order so; 1: all.
            For other sensors, ``pattern`` selects the points.
        period: time between two scans, s.
        pattern: how the rays of the LiDAR lie. None: as those of the environment's LiDAR, or of a VLP-16.
        in_keys: point clouds ``[*B, P, 3]`` (m, sensor frame), velocities ``[*B, 3]`` (m/s, world axes) and attitudes
            ``[*B, 3]`` (roll, pitch and yaw in rad).
        out_keys: where the objects go, ``[*B, K * 7]``: ``OBJECT`` of each, nearest first, 0 for none.

    Raises:
        ValueError: for a range, a number or a period that is not above 0, or another number of keys than three and one.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from uavrl.envs import NavigationEnv
        >>> from uavrl.envs.lidar import LidarConfig
        >>> base = NavigationEnv(2, lidar=LidarConfig(max_range=4.0, far_range=12.0))
        >>> env = TransformedEnv(base, MovingObjects(every=5))
        >>> env.rollout(3)["next", "moving_objects"].shape
        torch.Size([2, 3, 21])
    """

    alone = "MotionSight"

    def __init__(
        self,
        max_range: Annotated[float, Field(gt=0, le=1000)] = 12.0,
        objects: Annotated[int, Field(ge=1, le=100)] = 3,
        every: Annotated[int, Field(ge=1)] = 1,
        *,
        period: float = VEHICLE.period,
        pattern: ScanPattern | None = None,
        in_keys: Sequence[NestedKey] = ("point_cloud", "velocity", "attitude"),
        out_keys: Sequence[NestedKey] = ("moving_objects",),
    ) -> None:
        if min(max_range, objects, every, period) <= 0:
            raise ValueError(f"Expected values above 0, got {max_range=}, {objects=}, {every=}, {period=}.")
        if len(in_keys) != 3 or len(out_keys) != 1:
            raise ValueError(
                f"MovingObjects takes three in_keys (cloud, velocity, attitude) and one out_key, got {list(in_keys)} "
                f"and {list(out_keys)}."
            )
        super().__init__(in_keys=list(in_keys), out_keys=list(out_keys))
        self.max_range, self.objects, self.every, self.period = max_range, objects, every, period
        self.pattern = pattern
        self._flown: ScanPattern | None = None  # of the LiDAR that is followed; None for a VLP-16's
        self._sight: MotionSight | None = None
        self._last = torch.zeros(0, objects, len(OBJECT), dtype=torch.float32)

    def look(self, data: TensorDictBase, count: int, which: np.ndarray, begins: bool) -> TensorDictBase:
        """Writes the objects that each sensor sees."""
        cloud, velocity, attitude = (entry(data, key, self) for key in self.in_keys)
        batch = cloud.shape[:-2]
        if self._sight is None or len(self._last) != count:
            self._flown = self.pattern or self.parent_pattern  # once, as all rays are looked at
            self._sight = MotionSight(count, self.max_range, self.objects, self.period, self._flown or ScanPattern())
            self._last = torch.zeros(count, self.objects, len(OBJECT), dtype=torch.float32)
        points = cloud.detach().reshape(count, *cloud.shape[-2:])
        if self._flown is not None:
            points = torch.from_numpy(searched_alone(points.cpu().numpy(), self._flown))
        elif self.every > 1:
            points = points.unflatten(-2, (-1, LASERS))[:, :: self.every].flatten(1, 2)
        if begins:
            self._sight.reset(which)
        told = (values.reshape(count, 3).double() for values in (velocity, attitude))
        found = call_numpy(self._sight.look, points, *told, which)
        self._last[which] = found[which].to(self._last)
        return data.set(self.out_keys[0], self._last.reshape(*batch, -1).to(cloud, copy=True))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the spec of the objects."""
        assert isinstance(observation_spec, Composite)
        cloud, *_ = (entry_spec(observation_spec, key, self) for key in self.in_keys)
        shape = (*cloud.shape[:-2], self.objects * len(OBJECT))
        observation_spec[self.out_keys[0]] = Unbounded(shape, cloud.device, cloud.dtype)
        return observation_spec
