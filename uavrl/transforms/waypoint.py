"""The way through a map of the episode (:mod:`uavrl_onboard.guards.map`) as a transform of TorchRL."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded

from uavrl.entries import entry, entry_spec
from uavrl.transforms.through_time import ThroughTime
from uavrl_onboard.guards.map import Wayfinder
from uavrl_onboard.ranges import Positive
from uavrl_onboard.vehicle import VEHICLE, lidar_place


class Waypoint(ThroughTime):
    """Writes the heading to the next point of the quickest way to the goal, through all that was seen in the episode.

    See :class:`uavrl_onboard.guards.map.Wayfinder` for how. Read in place of the heading to the goal it gives any
    policy a memory:
    one that only avoids what it sees then finds out of dead ends. Where nothing known stands within a metre of the
    straight line to the goal, both are the same; how far the goal is it only guesses at first, so what stands behind
    it may turn the heading, too. It needs what an autopilot knows of itself, velocity and attitude. Ways are found
    while episodes run, on the CPU, and not in stored data.

    Args:
        sight: how far returns count, m.
        reach: m from the vehicle, beyond which it forgets.
        flight_level: m, the altitude of the map.
        period: time between two scans, s.
        sensor_position: of the LiDAR in body axes, m; 0.1 m above the hull's middle by default.
        in_keys: point clouds ``[*B, P, 3]`` (m, sensor frame), velocities ``[*B, 3]`` (m/s, world axes), attitudes
            ``[*B, 3]`` (roll, pitch and yaw in rad), altitudes ``[*B, 1]`` (m) and headings ``[*B, 1]`` (to the goal,
            left positive, degrees).
        out_keys: where the headings to the next waypoints go, ``[*B, 1]``, degrees in [0, 360).

    Raises:
        ValueError: for another number of keys than five and one, or a ``sensor_position`` that is not three finite
            numbers.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from uavrl.envs import NavigationEnv
        >>> from uavrl.envs.lidar import LidarConfig
        >>> env = TransformedEnv(NavigationEnv(2, lidar=LidarConfig(max_range=4.0, far_range=12.0)), Waypoint())
        >>> env.rollout(3)["next", "waypoint_deg"].shape
        torch.Size([2, 3, 1])
    """

    alone = "Wayfinder"

    def __init__(
        self,
        sight: Annotated[float, Field(gt=0, le=100)] = 12.0,
        reach: Annotated[float, Field(ge=5, le=100)] = 40.0,
        flight_level: Positive = VEHICLE.flight_level,
        *,
        period: Positive = VEHICLE.period,
        sensor_position: Sequence[float] = VEHICLE.lidar_position,
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
        self.sensor_position = lidar_place(sensor_position)
        self._finder: Wayfinder | None = None
        self._last = np.zeros(0)  # rad, of each vehicle, off its goal's direction

    def look(self, data: TensorDictBase, count: int, which: np.ndarray, begins: bool) -> TensorDictBase:
        """Writes the headings to the waypoints."""
        cloud, *told = (entry(data, key, self).detach().cpu() for key in self.in_keys)
        velocity, attitude = (each.reshape(count, 3).double().numpy() for each in told[:2])
        altitude, heading = (each.reshape(count).double().numpy() for each in told[2:])
        if self._finder is None or len(self._last) != count:
            self._finder = Wayfinder(
                count,
                self.sight,
                self.reach,
                self.flight_level,
                period=self.period,
                sensor_position=self.sensor_position,
            )
            self._last = np.zeros(count)
        if begins:
            self._finder.reset(which)
        points = cloud.reshape(count, *cloud.shape[-2:]).numpy()
        self._last[which] = self._finder.look(points, velocity, attitude, altitude, np.deg2rad(heading), which)[which]
        straight = data.get(self.in_keys[-1])
        turned = torch.from_numpy(np.rad2deg(self._last)).to(straight).reshape(straight.shape)
        around = (straight + turned).remainder(360).remainder(360)  # of -1e-6 the first makes 360 in float32
        return data.set(self.out_keys[0], torch.where(turned == 0, straight, around))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the spec of the headings."""
        assert isinstance(observation_spec, Composite)
        *_, heading = (entry_spec(observation_spec, key, self) for key in self.in_keys)
        observation_spec[self.out_keys[0]] = Unbounded(heading.shape, heading.device, heading.dtype)
        return observation_spec


def heading_to_waypoint(seen: TensorDictBase) -> TensorDictBase:
    """Puts the heading to the waypoint, where there is one, in place of that to the goal, into what a policy reads."""
    waypoint = seen.get("waypoint_deg", None)
    return seen if waypoint is None else seen.set("heading_deg", waypoint)
