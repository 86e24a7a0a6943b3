"""The point-cloud reductions' common shell: what TorchRL asks of a transform."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec
from torchrl.envs.transforms import Transform

from uavrl.transforms.functional import Statistic
from uavrl.upstream import missing_tolerance

__all__ = ["PointCloudReduction"]


class PointCloudReduction(Transform):
    """A cloud of points to a length for each of some cells around the sensor; the base of ours.

    A class says where its cells are (``directions``), its ``default_statistic`` and the function ``reduced``.

    Args:
        in_keys: point clouds ``[*B, P, 3]`` in metres in the sensor frame; NaN, inf or zeros where a ray hit nothing.
        out_keys: one key per cloud for ``[*B, cells]`` in metres, within [0, ``radius``].
        radius: of the ball outside of which nothing is seen, in metres.
        statistic: what a cell tells.
        del_keys: whether the point clouds are removed. ``False`` keeps them beside the cells.
    """

    invertible = False
    default_statistic: ClassVar[Statistic] = "face"

    @staticmethod
    def reduced(points: Tensor, radius: float, statistic: Statistic) -> Tensor:
        """Clouds ``[*B, P, 3]`` to ``[*B, cells]``."""
        raise NotImplementedError

    @staticmethod
    def directions() -> Tensor:
        """Unit vectors ``[cells, 3]`` through the cells, in the order in which they are reported."""
        raise NotImplementedError

    def __init__(
        self,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
        *,
        radius: float = 4.0,
        statistic: Statistic | None = None,
        del_keys: bool = True,
    ) -> None:
        super().__init__(
            in_keys=["point_cloud"] if in_keys is None else in_keys,
            out_keys=["faces"] if out_keys is None else out_keys,
        )
        if len(self.in_keys) != len(self.out_keys):
            raise ValueError(f"in_keys and out_keys must pair up, got {self.in_keys} and {self.out_keys}.")
        self.statistic: Statistic = self.default_statistic if statistic is None else statistic
        self.reduced(torch.empty(0, 3), radius, self.statistic)  # raises on bad options now, not in a worker
        self.radius = float(radius)
        self.del_keys = del_keys

    def _apply_transform(self, obs: Tensor) -> Tensor:
        return self.reduced(obs, self.radius, self.statistic)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._dropped(super()._call(next_tensordict))

    @dispatch(source="in_keys", dest="out_keys", auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reduces the clouds of ``tensordict`` in place, as a module or in a replay buffer."""
        return self._dropped(super().forward(tensordict))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        with missing_tolerance(self, True):
            return self._call(tensordict_reset)

    def _dropped(self, tensordict: TensorDictBase) -> TensorDictBase:
        if not self.del_keys:
            return tensordict
        return tensordict.exclude(*self._deleted(), inplace=True)

    def _deleted(self) -> list[NestedKey]:
        return [key for key in self.in_keys if key not in self.out_keys]

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Replaces the clouds' specs by bounded ``[*B, cells]`` specs."""
        if not isinstance(observation_spec, Composite):
            raise ValueError(f"{type(self).__name__} needs a Composite observation spec, got {observation_spec}.")
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            if in_key not in observation_spec.keys(True, True):
                raise KeyError(
                    f"{type(self).__name__} reads {in_key!r}, but the environment has only "
                    f"{sorted(map(str, observation_spec.keys(True, True)))}: set in_keys."
                )
            cloud = observation_spec[in_key]
            observation_spec[out_key] = Bounded(
                low=0.0,
                high=self.radius,
                shape=(*cloud.shape[:-2], len(self.directions())),
                dtype=cloud.dtype,
                device=cloud.device,
            )
        if self.del_keys:
            for key in self._deleted():
                del observation_spec[key]
        return observation_spec

    def __repr__(self) -> str:
        """Returns the constructor call."""
        return (
            f"{type(self).__name__}(in_keys={self.in_keys}, out_keys={self.out_keys}, radius={self.radius}, "
            f"statistic={self.statistic!r}, del_keys={self.del_keys})"
        )
