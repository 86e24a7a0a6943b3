"""The point-cloud reduction as a TorchRL transform (Chansuparp (2022), section 3.1)."""

from torch import Tensor

from uavrl.transforms.functional import truncated_icosahedron, truncated_icosahedron_faces
from uavrl.transforms.point_cloud_reduction import PointCloudReduction

__all__ = ["TruncatedIcosahedron"]


class TruncatedIcosahedron(PointCloudReduction):
    """Reduces point clouds to the 32 face distances of a truncated icosahedron (Chansuparp (2022), Eq. 3.1-3.2).

    The maths is `uavrl.transforms.functional.truncated_icosahedron`. The cloud itself is dropped from the data and from
    the specs, so that it never leaves the worker that cast it.

    Args:
        in_keys: point clouds ``[*B, P, 3]`` in metres in the sensor frame; NaN, inf or zeros where a ray hit nothing.
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

    reduced = staticmethod(truncated_icosahedron)

    @staticmethod
    def directions() -> Tensor:
        """The faces' outward normals ``[32, 3]``."""
        return truncated_icosahedron_faces().normals
