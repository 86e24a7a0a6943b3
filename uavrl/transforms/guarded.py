"""Guards (:mod:`uavrl_onboard.guards`) around an environment, as a transform of TorchRL."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded

from uavrl.entries import entry, entry_spec
from uavrl.transforms.through_time import ThroughTime
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.guards.settings import guard_settings
from uavrl_onboard.vehicle import VEHICLE, Vehicle

READ = ("point_cloud", "velocity", "attitude", "altitude", "heading_deg")
GOAL_HEADING = "goal_heading_deg"  # the heading to the goal itself, where the map turns "heading_deg"
FLOWN = "flown_action"


class Guarded(ThroughTime):
    """Puts guards between a policy and its environment; the policy needs to know nothing about them.

    The map turns ``heading_deg``, which everything behind this transform reads, and keeps the heading to the goal as
    ``goal_heading_deg``. Evasion and the shield change the velocities of ``action``; the yaw rate is never changed. The
    action that was flown is emitted as ``flown_action`` and is what :class:`~uavrl.transforms.LastAction` reads;
    ``action`` stays the one that was asked for. Append it first, before the point cloud is reduced. Guards work while
    episodes run, on the CPU, and not on stored data.

    Args:
        guards: which guards are on, as :func:`~uavrl_onboard.guards.settings.guard_settings` reads it.
        vehicle: hull, LiDAR, limits and flight level that the guards assume. The rays of another LiDAR than a VLP-16
            are those of the environment's.

    Raises:
        UavrlError: for unknown guards or settings.

    Examples:
        >>> from torchrl.envs import Compose, TransformedEnv
        >>> from uavrl.envs import NavigationEnv
        >>> from uavrl.envs.lidar import LidarConfig
        >>> from uavrl.transforms import NavigationState
        >>> base = NavigationEnv(2, lidar=LidarConfig(max_range=4.0, far_range=12.0))
        >>> env = TransformedEnv(base, Compose(Guarded("all"), NavigationState()))
        >>> env.rollout(3)["next", "flown_action"].shape
        torch.Size([2, 3, 4])
    """

    alone = "Guards"

    def __init__(self, guards: Any = "all", *, vehicle: Vehicle = VEHICLE) -> None:
        super().__init__(in_keys=list(READ), out_keys=[FLOWN], in_keys_inv=["action"], out_keys_inv=["action"])
        self.guards, self.vehicle = guard_settings(guards), vehicle
        self._made: Guards | None = None
        self._turns = np.zeros(0)  # rad
        self._flown: Tensor | None = None

    @property
    def leads(self) -> bool:
        """Whether the map turns headings."""
        return self.guards.map is not None

    def look(self, data: TensorDictBase, count: int, which: np.ndarray, begins: bool) -> TensorDictBase:
        """Takes in the scans, and turns the headings."""
        cloud, *told = (entry(data, key, self).detach().cpu() for key in self.in_keys)
        velocity, attitude = (each.reshape(count, 3).double().numpy() for each in told[:2])
        altitude, heading = (each.reshape(count).double().numpy() for each in told[2:])
        if self._made is None or self._made.vehicles != count:
            vehicle = self.vehicle
            if (rays := self.parent_pattern) is not None:
                vehicle = replace(vehicle, lidar_elevations=(rays.lowest, rays.highest), lidar_repeats=rays.repeats)
            self._made, self._turns = Guards(self.guards, count, vehicle), np.zeros(count)
        if begins:
            self._made.reset(which)
        clouds = cloud.reshape(count, *cloud.shape[-2:]).numpy()
        seen = Situation(clouds, velocity, attitude, altitude, np.deg2rad(heading), which=which)
        self._turns[which] = self._made.lead(seen)[which]
        if self.leads:
            straight = data.get("heading_deg")
            turned = torch.from_numpy(np.rad2deg(self._turns)).to(straight).reshape(straight.shape)
            around = (straight + turned).remainder(360).remainder(360)  # of -1e-6 the first makes 360 in float32
            data.set(GOAL_HEADING, straight).set("heading_deg", torch.where(turned == 0, straight, around))
        return data

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        asked = entry(tensordict, "action", self)
        if self._made is None or self._made.vehicles != asked.shape[:-1].numel():  # no scan came before it
            return self.forward(tensordict)
        flown = asked.detach().cpu().reshape(self._made.vehicles, -1).clone()
        limits = [self.vehicle.velocity_limit] * 3 + [self.vehicle.yaw_rate_limit]
        bounds = torch.tensor(limits, dtype=flown.dtype)
        flown = torch.minimum(torch.maximum(flown, -bounds), bounds)
        flown[:, :3] = torch.from_numpy(self._made.filter(flown[:, :3].numpy())).to(flown)
        self._flown = flown.reshape(asked.shape).to(asked)
        return tensordict.set("action", self._flown)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        assert self._flown is not None
        return self._call(next_tensordict.set(FLOWN, self._flown))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zero = self._action_spec().zero()
        return super()._reset(tensordict, tensordict_reset.set(FLOWN, zero))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the action that was flown, and the heading to the goal itself."""
        assert isinstance(observation_spec, Composite)
        *_, heading = (entry_spec(observation_spec, key, self) for key in self.in_keys)
        if self.leads:
            observation_spec[GOAL_HEADING] = Unbounded(heading.shape, heading.device, heading.dtype)
        observation_spec[FLOWN] = self._action_spec().clone()
        return observation_spec

    def _action_spec(self) -> TensorSpec:
        assert self.parent is not None, "only an environment's transform is reset"
        return entry_spec(cast(Composite, self.parent.full_action_spec), "action", self)
