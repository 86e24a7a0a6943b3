"""What transforms have in common that follow scans through time."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from tensordict import TensorDictBase
from torchrl.envs.transforms import Transform

from uavrl.entries import entry
from uavrl.errors import UavrlError
from uavrl.shown import Shown
from uavrl_onboard.perception.motion.rays import ScanPattern


class ThroughTime(Shown, Transform):
    """Sees each sensor's scans one after another while episodes run; ``look`` says what it makes of them."""

    invertible = False
    alone: ClassVar[str]  # what does the same for scans without an environment

    @abstractmethod
    def look(self, data: TensorDictBase, count: int, which: np.ndarray, begins: bool) -> TensorDictBase:
        """Writes what is seen into ``data`` of ``count`` sensors.

        Args:
            data: the observations; ``in_keys[0]`` is the clouds, ``[*B, P, 3]``.
            count: of all sensors.
            which: ``bool [count]``, which have a new scan; of the others the last output stays.
            begins: whether the episodes of these begin.
        """

    @property
    def parent_pattern(self) -> ScanPattern | None:
        """How the rays of the simulated LiDAR lie; None for a VLP-16, and in an environment that does not tell."""
        base = getattr(self.container, "base_env", None)
        device = getattr(getattr(base, "lidar_config", None), "device", None)
        if device is None or device.fires_as_vlp16:
            return None
        lowest, highest = device.field_of_view[2:]
        return ScanPattern(lowest, highest, device.repeats)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Refuses: stored data does not say which scan follows which."""
        raise UavrlError(
            f"{type(self).__name__} follows scans through time: append it to an environment, or give the scans of one "
            f"sensor after another to a {self.alone}."
        )

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        count = entry(next_tensordict, self.in_keys[0], self).shape[:-2].numel()
        return self.look(next_tensordict, count, np.ones(count, bool), begins=False)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        count = entry(tensordict_reset, self.in_keys[0], self).shape[:-2].numel()
        mask = None if tensordict is None else tensordict.get("_reset", None)
        which = np.ones(count, bool) if mask is None else mask.reshape(-1).cpu().numpy()
        return self.look(tensordict_reset, count, which, begins=True)
