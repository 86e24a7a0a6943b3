"""What point-cloud reductions share: which points count, what cells report, and the shell that TorchRL asks for."""

import math
from collections.abc import Sequence
from numbers import Real
from typing import ClassVar, get_args

import torch
from tensordict import TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec
from torchrl.envs.transforms import Transform

from uavrl.entries import entry, entry_spec
from uavrl.errors import UavrlError
from uavrl_onboard.geometry import NEAREST_RETURN
from uavrl_onboard.perception.cells import LARGEST_RADIUS, Statistic, return_bounds
from uavrl_onboard.perception.view import SLACK, View

__all__ = ["PointCloudReduction", "Statistic", "is_return"]


def check_points(points: Tensor, radius: float, statistic: Statistic) -> None:
    """Refuses what is no cloud, no length above the sensor's housing, where nothing is ever seen, or no statistic."""
    if not isinstance(points, Tensor):
        raise UavrlError(
            f"points must be a tensor [*B, P, 3], got a {type(points).__name__}: pass torch.tensor(points)."
        )
    if points.ndim < 2 or points.shape[-1] != 3:
        hint = ": pass points[..., :3]" if points.ndim > 1 and points.shape[-1] > 3 else ""
        raise ValueError(f"points must have shape [*B, P, 3], got {tuple(points.shape)}{hint}.")
    if points.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"points must be float32 or float64, got {points.dtype}.")
    check_radius(radius)
    if statistic not in get_args(Statistic):
        raise ValueError(f'statistic must be "face", "range" or "proximity", got {statistic!r}.')


def check_radius(radius: float) -> None:
    """Refuses what is no length, and balls that lie within the sensor's housing."""
    if not (isinstance(radius, Real) and NEAREST_RETURN < radius <= LARGEST_RADIUS):
        raise ValueError(
            f"radius must be a positive length in metres, above {NEAREST_RETURN:g} (the sensor's housing) and at most "
            f"{LARGEST_RADIUS:g}, got {radius!r}."
        )


def is_return(points: Tensor, radius: float) -> Tensor:
    """Returns which points are returns of the sensor from within the ball: ``bool [*B, P]``.

    What drivers write for a ray that hit nothing is a miss, whatever the driver: a NaN or an infinite coordinate, and
    zeros. A point within 0.05 m of the sensor's centre lies inside its housing and is a miss, too. So is a point at or
    beyond ``radius``, or less than ``1e-6 * radius`` before it: a scan whose range is cut to ``radius`` therefore
    reduces to exactly what the uncut scan does.

    Args:
        points: ``[*B, P, 3]`` in metres in the sensor frame.
        radius: of the ball in metres.

    Examples:
        >>> points = torch.tensor([[3.0, 0.0, 0.0], [0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [torch.nan, 0.0, 0.0]])
        >>> is_return(points, 4.0).tolist()
        [True, False, False, False]
    """
    x, y, z = points.unbind(-1)
    squared = (x * x + y * y).addcmul_(z, z)
    nearest, farthest = return_bounds(radius)
    return (squared > nearest) & (squared < farthest)


def returns_of(points: Tensor, radius: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The coordinates ``[M]`` of all returns in clouds ``[*B, P, 3]``, and the number of the cloud that each is in."""
    kept = is_return(points, radius).reshape(-1).nonzero()[:, 0]  # most of a scan's points are misses
    x, y, z = (coordinate.reshape(-1).index_select(0, kept) for coordinate in points.unbind(-1))
    return x, y, z, kept.div(max(points.shape[-2], 1), rounding_mode="floor")


def in_view(points: Tensor, view: View) -> Tensor:
    """Returns which points lie in a field of view, or at most 0.5 degrees beside it: ``bool [*B, P]``.

    Args:
        points: ``[*B, P, 3]`` in the sensor frame.
        view: the rightmost, leftmost, lowest and highest direction, degrees.

    Examples:
        >>> in_view(torch.tensor([[2.0, 0.0, 0.0], [2.0, 0.0, 2.0]]), (-180.0, 180.0, -15.0, 15.0)).tolist()
        [True, False]
    """
    x, y, z = points.unbind(-1)
    right, left, low, high = view
    elevation = torch.rad2deg(torch.atan2(z, torch.hypot(x, y)))
    seen = (elevation >= low - SLACK) & (elevation <= high + SLACK)
    if left - right + 2 * SLACK < 360.0:
        from_right = (torch.rad2deg(torch.atan2(y, x)) - (right - SLACK)).remainder(360.0)
        seen &= from_right <= left - right + 2 * SLACK
    return seen


def least_of(lengths: Tensor, clouds: Tensor, cells: Tensor, shape: tuple[int, ...]) -> Tensor:
    """The least of ``lengths [M]`` in each cell of each cloud, ``shape [*B, cells]``, infinite where there is none."""
    least = lengths.new_full((math.prod(shape),), torch.inf)
    return least.scatter_reduce(0, clouds * shape[-1] + cells, lengths, "amin").reshape(shape)


def reported(least: Tensor, radius: float, statistic: Statistic) -> Tensor:
    """What cells report: their least lengths, infinite where there is no point, or what ``"proximity"`` makes of it."""
    if statistic == "proximity":
        return (radius - least).clamp_min(0.0)
    return torch.where(least.isinf(), 0.0, least)


class PointCloudReduction(Transform):
    """A cloud of points to a length for each of some cells around the sensor; the base of ours.

    A class says where its cells are (``directions``), its ``default_statistic`` and the function ``reduced``. The cloud
    is dropped from the data and the specs, so that it never leaves the worker that cast it.

    Args:
        in_keys: point clouds ``[*B, P, 3]`` in metres in the sensor frame; NaN, inf or zeros where a ray hit nothing.
        out_keys: one key per cloud for ``[*B, cells]`` in metres, within [0, ``radius``].
        radius: of the ball outside of which nothing is seen, in metres.
        statistic: what a cell reports; None for the class's own.
        del_keys: whether the point clouds are removed. ``False`` keeps them beside the cells.

    Attributes:
        view: the field of view that cells read: the rightmost, leftmost, lowest and highest direction in degrees.
            Points more than 0.5 degrees outside are misses. None, as at first: cells read all points.
    """

    invertible = False
    default_statistic: ClassVar[Statistic] = "face"
    view: View | None = None

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
        if self.view is not None:
            obs = torch.where(in_view(obs, self.view)[..., None], obs, torch.nan)
        return self.reduced(obs, self.radius, self.statistic)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._reduce(next_tensordict)

    @dispatch(source="in_keys", dest="out_keys", auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reduces the clouds of ``tensordict`` in place, as a module or in a replay buffer."""
        return self._reduce(tensordict)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._reduce(tensordict_reset)

    def _reduce(self, tensordict: TensorDictBase) -> TensorDictBase:
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            tensordict.set(out_key, self._apply_transform(entry(tensordict, in_key, self)))
        return tensordict.exclude(*self._deleted(), inplace=True)

    def _deleted(self) -> list[NestedKey]:
        return [key for key in self.in_keys if key not in self.out_keys] if self.del_keys else []

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Replaces the clouds' specs by bounded ``[*B, cells]`` specs."""
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            cloud = entry_spec(observation_spec, in_key, self)
            assert isinstance(observation_spec, Composite)
            shape = (*cloud.shape[:-2], len(self.directions()))
            observation_spec[out_key] = Bounded(0.0, self.radius, shape, cloud.device, cloud.dtype)
        for key in self._deleted():
            del observation_spec[key]
        return observation_spec

    def unseen_cells(self, rays: Tensor) -> list[int]:
        """Lists the cells in which a sensor never reports a point.

        Args:
            rays: directions of the sensor's rays ``[R, 3]``, x forward, y left, z up.

        Examples:
            A VLP-16 sees 15 degrees up and down: 24 of the 32 faces, and all 72 cells of the range image.

            >>> from uavrl_onboard.lidar.vlp16 import firing_directions
            >>> from uavrl.transforms import RangeImage, TruncatedIcosahedron
            >>> rays = torch.from_numpy(firing_directions())
            >>> len(TruncatedIcosahedron().unseen_cells(rays)), RangeImage().unseen_cells(rays)
            (8, [])
        """
        directions = torch.nn.functional.normalize(torch.as_tensor(rays).double(), dim=-1)
        distances = torch.linspace(NEAREST_RETURN, self.radius, 9, dtype=torch.float64)[1:] * (1.0 - 1e-3)
        seen = self.reduced((distances[:, None, None] * directions).reshape(-1, 3), self.radius, "range")
        return (seen == 0).nonzero()[:, 0].tolist()

    def __repr__(self) -> str:
        """Returns the constructor call."""
        return (
            f"{type(self).__name__}(in_keys={self.in_keys}, out_keys={self.out_keys}, radius={self.radius}, "
            f"statistic={self.statistic!r}, del_keys={self.del_keys})"
        )
