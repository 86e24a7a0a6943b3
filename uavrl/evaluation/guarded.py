"""A policy behind guards: a map of the episode leads it, evasion and a shield change its velocities, in this order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from tensordict import TensorDictBase

from uavrl.envs.limits import OrMapping, settings
from uavrl.envs.quadrotor import Airframe
from uavrl.policy_protocol import Acts, PolicyModule, as_policy
from uavrl.transforms.state import ACTION_LIMIT
from uavrl.transforms.waypoint import heading_to_waypoint
from uavrl_onboard.geometry import world_to_yaw
from uavrl_onboard.guards.evasion import Evasion
from uavrl_onboard.guards.shield import Shield
from uavrl_onboard.vehicle import VEHICLE

SCAN = ("point_cloud", "attitude", "velocity")  # what evasion and shield read
EPISODE = ("altitude", "is_init")  # what evasion reads besides


class GuardedPolicy(PolicyModule):
    """A policy whose velocities guards change before they are flown; its yaw rate is never changed.

    Guards read the point clouds and ``is_init``, which `uavrl.evaluation.environment.make_env` emits with
    ``keep_cloud=True`` and ``mark_resets=True``.

    Args:
        policy: writes ``action``.
        led: show the policy the heading to the :class:`~uavrl.transforms.Waypoint` as the heading to the goal; for
            policies that read ``heading_deg`` themselves.
        evade: range in m up to which moving objects are detected and evaded
            (:class:`~uavrl_onboard.guards.evasion.Evasion`); the scans must reach as far (``far_range`` of
            `uavrl.envs.lidar.LidarConfig`). None: no evasion.
        shield: limits the speed near obstacles. None: no shield.
        flight_level: altitude around which the vehicle may fly, m.
        airframe: hull and LiDAR position that evasion reckons with; None: the default airframe.

    Examples:
        Something stands 1 m ahead of the hull: the shield slows the approach, evasion ignores what does not move.

        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> ahead = TensorDictModule(lambda cells: cells.new_tensor([[2.0, 0.0, 0.0, 1.0]]), ["cells"], ["action"])
        >>> seen = TensorDict(cells=torch.zeros(1, 72), point_cloud=torch.tensor([[[1.35, 0.0, -0.1]]]), batch_size=[1])
        >>> seen["attitude"] = seen["velocity"] = torch.zeros(1, 3)
        >>> seen["altitude"], seen["is_init"] = torch.full((1, 1), 3.5), torch.ones(1, 1, dtype=torch.bool)
        >>> GuardedPolicy(ahead, evade=12.0)(seen)["action"]
        tensor([[2., 0., 0., 1.]])
        >>> GuardedPolicy(ahead, evade=12.0, shield=Shield())(seen)["action"].round(decimals=2).abs()
        tensor([[1.2600, 0.0000, 0.0000, 1.0000]])
    """

    def __init__(
        self,
        policy: Acts,
        *,
        led: bool = False,
        evade: Annotated[float, Field(gt=0, le=100)] | None = None,
        shield: Shield | None = None,
        flight_level: float = VEHICLE.flight_level,
        airframe: OrMapping[Airframe] | None = None,
    ) -> None:
        super().__init__()
        self.policy = as_policy(policy)
        self.has_map, self.overrides = self.policy.has_map, self.policy.overrides
        self.led, self.evade, self.shield = led, evade, shield
        self.vehicle = settings("airframe", Airframe, airframe).vehicle(flight_level)
        filters = evade is not None or shield is not None
        self.reads = (*SCAN * filters, *EPISODE * (evade is not None))
        led_by = ["waypoint_deg"] * led
        self.in_keys = [*dict.fromkeys([*self.policy.in_keys, *led_by, *self.reads])]
        self.out_keys = list(self.policy.out_keys)
        self._evasion: Evasion | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` within its limits; a policy that keeps its last action receives the one that is flown."""
        if self.led:  # the goal's own heading stays
            acted = self.policy(heading_to_waypoint(tensordict.copy()))["action"]
            tensordict = tensordict.set("action", acted)
        else:
            tensordict = self.policy(tensordict)
        return self._filter(tensordict) if self.reads else tensordict

    def flown(self, actions: np.ndarray) -> None:
        """Take the actions that the vehicles fly, as the policy does."""
        self.policy.flown(actions)

    def _filter(self, tensordict: TensorDictBase) -> TensorDictBase:
        acted, dims = tensordict["action"], tensordict["action"].ndim - 1
        asked = acted.detach().cpu().reshape(-1, *acted.shape[dims:]).clamp(-ACTION_LIMIT, ACTION_LIMIT)
        read = {key: tensordict[key].detach().cpu() for key in self.reads}
        seen = {key: value.reshape(-1, *value.shape[dims:]).numpy() for key, value in read.items()}
        velocities = asked[:, :3].numpy()
        if self.evade is not None:
            velocities = self._evaded(velocities, self.evade, seen)
        if self.shield is not None:
            velocities = _shielded(velocities, self.shield, seen)
        asked[:, :3] = torch.from_numpy(velocities)
        self.flown(asked.numpy())
        return tensordict.set("action", asked.view(acted.shape).to(acted))

    def _evaded(self, asked: np.ndarray, max_range: float, seen: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the velocities ``[N, 3]`` that avoid moving objects."""
        if self._evasion is None or self._evasion.vehicles != len(asked):
            self._evasion = Evasion(len(asked), max_range, vehicle=self.vehicle)
        self._evasion.reset(seen["is_init"][:, 0])
        heights = seen["altitude"][:, 0] - self.vehicle.flight_level
        evaded = self._evasion(asked, seen["point_cloud"], seen["velocity"], seen["attitude"], heights)
        return evaded.astype(np.float32)


def _shielded(asked: np.ndarray, shield: Shield, seen: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the velocities ``[N, 3]`` that the shield allows."""
    own = world_to_yaw(seen["velocity"], seen["attitude"][:, 2])
    rows = zip(asked, seen["point_cloud"], seen["attitude"], own, strict=True)
    allowed = [shield(wanted, cloud, tuple(angles[:2]), velocity) for wanted, cloud, angles, velocity in rows]
    return np.array(allowed).reshape(-1, 3)
