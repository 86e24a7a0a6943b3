"""The way through a map of the episode (:mod:`uavrl.mapping`) as a transform of TorchRL."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from uavrl.errors import UavrlError
from uavrl.mapping import Wayfinder
from uavrl.ranges import Positive


class Waypoint(Transform):
    """Writes the heading to the next point of the quickest way to the goal, through all that was seen in the episode.

    See :class:`uavrl.mapping.Wayfinder` for how. Read in place of the heading to the goal it gives any policy a memory:
    one that only avoids what it sees then finds out of dead ends. Where nothing known stands within a metre of the
    straight line to the goal, both are the same; how far the goal is it only guesses at first, so what stands behind
    it may turn the heading, too. It needs what an autopilot knows of itself, velocity and attitude. Ways are found
    while episodes run, on the CPU, and not in stored data.

    Args:
        sight: how far returns count, m.
        reach: m from the vehicle, beyond which it forgets.
        flight_level: m, the altitude of the map.
        period: time between two scans, s.
        in_keys: point clouds ``[*B, P, 3]`` (m, sensor frame), velocities ``[*B, 3]`` (m/s, world axes), attitudes
            ``[*B, 3]`` (roll, pitch and yaw in rad), altitudes ``[*B, 1]`` (m) and headings ``[*B, 1]`` (to the goal,
            left positive, degrees).
        out_keys: where the headings to the next waypoints go, ``[*B, 1]``, degrees in [0, 360).

    Raises:
        ValueError: for another number of keys than five and one.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from uavrl.envs import NavigationEnv
        >>> from uavrl.envs.lidar import LidarConfig
        >>> env = TransformedEnv(NavigationEnv(2, lidar=LidarConfig(max_range=4.0, far_range=12.0)), Waypoint())
        >>> env.rollout(3)["next", "waypoint_deg"].shape
        torch.Size([2, 3, 1])
    """

    invertible = False

    def __init__(
        self,
        sight: Annotated[float, Field(gt=0, le=100)] = 12.0,
        reach: Annotated[float, Field(ge=5, le=100)] = 40.0,
        flight_level: Positive = 3.5,
        *,
        period: Positive = 0.1,
        in_keys: Sequence[NestedKey] = ("point_cloud", "velocity", "attitude", "altitude", "heading_deg"),
        out_keys: Sequence[NestedKey] = ("waypoint_deg",),
    ) -> None:
        if len(in_keys) != 5 or len(out_keys) != 1:
            raise ValueError(
                f"Waypoint takes five in_keys (cloud, velocity, attitude, altitude, heading) and one out_key, got "
                f"{list(in_keys)} and {list(out_keys)}."
            )
        super().__init__(in_keys=list(in_keys), out_keys=list(out_keys))
        self.sight, self.reach, self.flight_level, self.period = sight, reach, flight_level, period
        self._finder: Wayfinder | None = None
        self._last = np.zeros(0)  # rad, of each vehicle, off its goal's direction

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Refuses: stored data does not say which scan follows which."""
        raise UavrlError(
            "Waypoint follows scans through time: append it to an environment, or give the scans of one vehicle after "
            "another to a Wayfinder."
        )

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._look(next_tensordict, None)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        return self._look(tensordict_reset, True if mask is None else mask.reshape(-1).cpu().numpy())

    def _look(self, data: TensorDictBase, fresh: np.ndarray | bool | None) -> TensorDictBase:
        """Lets all vehicles look, or those alone whose episodes begin; the others keep the way that they have."""
        told = [data.get(key).detach().cpu() for key in self.in_keys]
        batch = told[0].shape[:-2]
        count = batch.numel()
        cloud = told[0].reshape(count, *told[0].shape[-2:]).numpy()
        velocity, attitude = (each.reshape(count, 3).double().numpy() for each in told[1:3])
        altitude, heading = (each.reshape(count).double().numpy() for each in told[3:])
        if self._finder is None or len(self._last) != count:
            self._finder = Wayfinder(count, self.sight, self.reach, self.flight_level, period=self.period)
            self._last = np.zeros(count)
        which = np.broadcast_to(True if fresh is None else fresh, count)
        if fresh is not None:
            self._finder.reset(which)
        turns = self._finder.look(cloud, velocity, attitude, altitude, np.deg2rad(heading), which)
        self._last[which] = turns[which]
        straight = data.get(self.in_keys[-1])
        turned = torch.from_numpy(np.rad2deg(self._last)).to(straight).reshape(straight.shape)
        around = (straight + turned).remainder(360).remainder(360)  # of -1e-6 the first makes 360 in float32
        return data.set(self.out_keys[0], torch.where(turned == 0, straight, around))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the spec of the headings."""
        assert isinstance(observation_spec, Composite)
        heading = observation_spec[self.in_keys[-1]]
        observation_spec[self.out_keys[0]] = Unbounded(heading.shape, heading.device, heading.dtype)
        return observation_spec
