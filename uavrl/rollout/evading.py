"""Any policy out of the ways of what moves."""

from collections.abc import Callable, Mapping
from typing import Annotated

import numpy as np
from pydantic import Field
from tensordict import TensorDictBase

from uavrl.envs.limits import OrMapping, settings
from uavrl.envs.quadrotor import Airframe
from uavrl.motion.evasion import Evasion
from uavrl.rollout.filtered import Filtered


class Evading(Filtered):
    """Flies what a policy asks for, where nothing that moves will be: else what `uavrl.motion.evasion.Evasion` chooses.

    It reads the point clouds and ``is_init`` beside what the policy reads, which
    `uavrl.rollout.environment.make_env` gives with ``keep_cloud=True`` and ``mark_resets=True``.

    Args:
        policy: writes ``action``.
        max_range: how far moving objects are looked for, m; the scans must reach as far (``far_range`` of
            `uavrl.envs.lidar.LidarConfig`).
        flight_level: altitude around which it may fly, m.
        airframe: whose hull and LiDAR it reckons with; None for the default one.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> ahead = TensorDictModule(lambda cells: cells.new_tensor([[2.0, 0.0, 0.0, 1.0]]), ["cells"], ["action"])
        >>> seen = TensorDict(cells=torch.zeros(1, 72), point_cloud=torch.tensor([[[3.0, 0.0, 0.0]]]), batch_size=[1])
        >>> seen["attitude"] = seen["velocity"] = torch.zeros(1, 3)
        >>> seen["altitude"], seen["is_init"] = torch.full((1, 1), 3.5), torch.ones(1, 1, dtype=torch.bool)
        >>> Evading(ahead)(seen)["action"]  # what stands is left to the policy
        tensor([[2., 0., 0., 1.]])
    """

    def __init__(
        self,
        policy: Callable[[TensorDictBase], TensorDictBase],
        max_range: Annotated[float, Field(gt=0, le=100)] = 12.0,
        *,
        flight_level: float = 3.5,
        airframe: OrMapping[Airframe] | None = None,
    ) -> None:
        super().__init__(policy, ("point_cloud", "attitude", "velocity", "altitude", "is_init"))
        self.max_range, self.flight_level = max_range, flight_level
        self.airframe = settings("airframe", Airframe, airframe)
        self._evasion: Evasion | None = None

    def velocities(self, asked: np.ndarray, seen: Mapping[str, np.ndarray]) -> np.ndarray:
        """Those out of the ways of what moves."""
        if self._evasion is None or self._evasion.vehicles != len(asked):
            hull, sensor = self.airframe.hull, self.airframe.lidar_position[2]
            self._evasion = Evasion(len(asked), self.max_range, hull=hull, sensor=sensor)
        self._evasion.reset(seen["is_init"][:, 0])
        heights = seen["altitude"][:, 0] - self.flight_level
        return self._evasion(asked, seen["point_cloud"], seen["velocity"], seen["attitude"], heights)
