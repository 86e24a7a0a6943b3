"""Any policy behind a shield."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from uavrl.shield import Shield
from uavrl.transforms.state import ACTION_LIMIT
from uavrl.transforms.threats import to_yaw


class Shielded(TensorDictModuleBase):
    """Flies what a policy asks for, as far as :class:`uavrl.shield.Shield` lets it: the yaw rate always.

    It reads the point clouds beside what the policy reads, which `uavrl.rollout.environment.make_env` keeps with
    ``keep_cloud=True``.

    Args:
        policy: writes ``action``.
        shield: None for one with the usual numbers.

    Examples:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> ahead = TensorDictModule(lambda cells: cells.new_tensor([[2.0, 0.0, 0.0, 1.0]]), ["cells"], ["action"])
        >>> seen = TensorDict(cells=torch.zeros(1, 72), point_cloud=torch.tensor([[[1.35, 0.0, -0.1]]]), batch_size=[1])
        >>> seen["attitude"] = seen["velocity"] = torch.zeros(1, 3)
        >>> Shielded(ahead)(seen)["action"].round(decimals=2).abs()
        tensor([[1.2600, 0.0000, 0.0000, 1.0000]])
    """

    def __init__(self, policy: Callable[[TensorDictBase], TensorDictBase], shield: Shield | None = None) -> None:
        super().__init__()
        self.policy: Any = policy
        self.shield = Shield() if shield is None else shield
        self.in_keys = [*dict.fromkeys([*getattr(policy, "in_keys", ()), "point_cloud", "attitude", "velocity"])]
        self.out_keys = list(getattr(policy, "out_keys", ["action"]))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``, within its limits, and tells a policy that keeps its last action what is flown."""
        tensordict = self.policy(tensordict)
        keys = ("action", "point_cloud", "attitude", "velocity")
        acted, clouds, attitudes, velocities = (tensordict[key].detach().cpu() for key in keys)
        clouds = clouds.reshape(acted[..., 0].numel(), *clouds.shape[-2:])
        acted, attitudes, velocities = (each.reshape(-1, each.shape[-1]) for each in (acted, attitudes, velocities))
        asked = acted.clamp(-ACTION_LIMIT, ACTION_LIMIT)
        own = to_yaw(velocities, attitudes[:, 2])
        rows = zip(*(each.numpy() for each in (asked[:, :3], clouds, attitudes[:, :2], own)), strict=True)
        fits = [self.shield(wanted, cloud, tuple(tilt), velocity) for wanted, cloud, tilt, velocity in rows]
        asked[:, :3] = torch.from_numpy(np.array(fits).reshape(-1, 3))
        if hasattr(self.policy, "flown"):
            self.policy.flown(asked.numpy())
        return tensordict.set("action", asked.view(tensordict["action"].shape).to(tensordict["action"]))
