"""The point-cloud reduction as a TorchRL transform (Chansuparp (2022), section 3.1)."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec
from torchrl.envs.transforms import Transform

from uavrl.transforms.functional import NUM_FACES, Statistic, truncated_icosahedron
from uavrl.upstream import missing_tolerance

__all__ = ["TruncatedIcosahedron"]


class TruncatedIcosahedron(Transform):
    """Reduces point clouds to the 32 face distances of a truncated icosahedron (Chansuparp (2022), Eq. 3.1-3.2).

    The maths is `uavrl.transforms.functional.truncated_icosahedron`. The cloud itself is dropped from the data and from
    the specs, so that it never leaves the worker that cast it.

    Args:
        in_keys: point clouds ``[*B, P, 3]`` in metres in the sensor frame, NaN where a ray hit nothing.
        out_keys: one key per cloud for ``[*B, 32]`` in metres, within [0, ``radius``].
        radius: circumradius in metres.
        statistic: ``"face"`` (distance to the face's centre), ``"range"`` (distance to the sensor) or ``"proximity"``
            (radius less the range).
        del_keys: whether the point clouds are removed. ``False`` keeps them beside the faces.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from uavrl.transforms.truncated_icosahedron import TruncatedIcosahedron
        >>> reduce = TruncatedIcosahedron()
        >>> reduce(TensorDict(point_cloud=torch.full((2, 28928, 3), torch.nan), batch_size=[2]))["faces"].shape
        torch.Size([2, 32])
    """

    invertible = False

    def __init__(
        self,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
        *,
        radius: float = 4.0,
        statistic: Statistic = "face",
        del_keys: bool = True,
    ) -> None:
        super().__init__(
            in_keys=["point_cloud"] if in_keys is None else in_keys,
            out_keys=["faces"] if out_keys is None else out_keys,
        )
        if len(self.in_keys) != len(self.out_keys):
            raise ValueError(f"in_keys and out_keys must pair up, got {self.in_keys} and {self.out_keys}.")
        truncated_icosahedron(torch.empty(0, 3), radius, statistic)  # raises on bad options now, not in a worker
        self.radius = float(radius)
        self.statistic: Statistic = statistic
        self.del_keys = del_keys

    def _apply_transform(self, obs: Tensor) -> Tensor:
        return truncated_icosahedron(obs, self.radius, self.statistic)

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
        """Replaces the clouds' specs by bounded ``[*B, 32]`` specs."""
        if not isinstance(observation_spec, Composite):
            raise ValueError(f"TruncatedIcosahedron needs a Composite observation spec, got {observation_spec}.")
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            if in_key not in observation_spec.keys(True, True):
                raise KeyError(
                    f"TruncatedIcosahedron reads {in_key!r}, but the environment has only "
                    f"{sorted(map(str, observation_spec.keys(True, True)))}: set in_keys."
                )
            cloud = observation_spec[in_key]
            observation_spec[out_key] = Bounded(
                low=0.0, high=self.radius, shape=(*cloud.shape[:-2], NUM_FACES), dtype=cloud.dtype, device=cloud.device
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
