"""An exported policy in the simulator: the same code that flies a vehicle, on what the environment emits."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from uavrl.envs.simulation import CONTROL_RATE
from uavrl.errors import UavrlError
from uavrl.transforms.guarded import FLOWN
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.perception.cells import VLP16_GRID
from uavrl_onboard.policy.policy import Policy
from uavrl_onboard.vehicle import VEHICLE


class ExportedPolicy:
    """Flies simulated vehicles by a folder that ``uavrl-export`` wrote.

    Args:
        folder: the exported policy.

    Raises:
        UavrlError: as :class:`~uavrl_onboard.policy.policy.Policy`, and for a contract of another rate than the
            simulator's.
    """

    has_map = False

    def __init__(self, folder: str | Path) -> None:
        self._policy = Policy(folder)
        self._vehicles: list[Policy] = []
        motion = () if self._policy.contract.motion is None else ("velocity", "attitude")
        self.out_keys = ("action",)
        self.in_keys = ("is_init", "point_cloud", "altitude", "heading_deg", "elevation_deg", *motion)
        if self._policy.contract.rate_hz != CONTROL_RATE:
            other = f"{folder} acts {self._policy.contract.rate_hz:g} times a second"
            raise UavrlError(f"{other}, and the simulator asks {CONTROL_RATE} times: choose another policy.")

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``; a vehicle with ``is_init`` begins an episode, and behind guards its last one was flown."""
        begins, cloud, *told = (tensordict[key].numpy() for key in self.in_keys)
        flown = tensordict.get(FLOWN, None)
        while len(self._vehicles) < len(cloud):
            self._vehicles.append(self._policy.copy())
        actions = np.zeros((len(cloud), len(self._policy.contract.action.order)), np.float32)
        for number, vehicle in enumerate(self._vehicles[: len(cloud)]):
            if begins[number].all():
                vehicle.reset()
            elif flown is not None:
                vehicle.last_action = flown[number].numpy().copy()
            altitude, heading, elevation = (float(part[number, 0]) for part in told[:3])
            actions[number] = vehicle(cloud[number], altitude, heading, elevation, *(part[number] for part in told[3:]))
        return tensordict.set("action", torch.from_numpy(actions))

    @property
    def guards(self) -> GuardSettings:
        """The guards that the policy flies with by default."""
        return self._policy.contract.guard_settings

    @property
    def overrides(self) -> dict[str, Any]:
        """The keys of a configuration whose environment and perception are the contract's."""
        terms = self._policy.contract
        perception = {key: getattr(terms.cells, key) for key in ("radius", "reduction", "statistic")}
        if terms.cells.grid != VLP16_GRID:
            perception["grid"] = asdict(terms.cells.grid)
        perception |= {"flight_level": terms.flight_level, "angles": terms.angles, "frames": terms.state.frames}
        perception |= {"last_action": terms.action_limit is not None, **({"blind": True} if terms.cloud.blind else {})}
        perception |= {} if terms.motion is None else {"motion": terms.motion.max_range}
        name = "vlp16" if terms.cloud.lidar is None else terms.cloud.lidar.name
        if name != "vlp16":
            perception["lidar.sensor"] = name  # of somebody's own, whose rays are not in the contract, a command asks
        velocity_limit = terms.action.high[0]
        perception["max_speed"] = velocity_limit  # its own, whatever that of the environment is
        sensor: dict[str, Any] = {"env.airframe.lidar_position": list(terms.cloud.sensor_position)}
        if velocity_limit != VEHICLE.velocity_limit:
            sensor["env.max_speed"] = velocity_limit
        return {f"perception.{key}": value for key, value in perception.items()} | sensor
