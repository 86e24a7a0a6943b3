"""Any policy behind a shield."""

from collections.abc import Callable, Mapping

import numpy as np
from tensordict import TensorDictBase

from uavrl.evaluation.filtered import Filtered
from uavrl_onboard.guards.shield import Shield
from uavrl_onboard.perception.motion.threats import to_yaw


class Shielded(Filtered):
    """Flies what a policy asks for, as far as :class:`uavrl_onboard.guards.shield.Shield` lets it: the yaw rate always.

    It reads the point clouds beside what the policy reads, which `uavrl.evaluation.environment.make_env` keeps with
    ``keep_cloud=True``.

    Args:
        policy: writes ``action``.
        shield: None for one with the usual numbers.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> ahead = TensorDictModule(lambda cells: cells.new_tensor([[2.0, 0.0, 0.0, 1.0]]), ["cells"], ["action"])
        >>> seen = TensorDict(cells=torch.zeros(1, 72), point_cloud=torch.tensor([[[1.35, 0.0, -0.1]]]), batch_size=[1])
        >>> seen["attitude"] = seen["velocity"] = torch.zeros(1, 3)
        >>> Shielded(ahead)(seen)["action"].round(decimals=2).abs()
        tensor([[1.2600, 0.0000, 0.0000, 1.0000]])
    """

    def __init__(self, policy: Callable[[TensorDictBase], TensorDictBase], shield: Shield | None = None) -> None:
        super().__init__(policy, ("point_cloud", "attitude", "velocity"))
        self.shield = Shield() if shield is None else shield

    def velocities(self, asked: np.ndarray, seen: Mapping[str, np.ndarray]) -> np.ndarray:
        """What the shield lets through of each vehicle's."""
        own = to_yaw(seen["velocity"], seen["attitude"][:, 2])
        rows = zip(asked, seen["point_cloud"], seen["attitude"], own, strict=True)
        fits = [self.shield(wanted, cloud, tuple(angles[:2]), velocity) for wanted, cloud, angles, velocity in rows]
        return np.array(fits).reshape(-1, 3)
