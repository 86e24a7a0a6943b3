"""The thesis's point-cloud reduction to the faces of a truncated icosahedron (Chansuparp (2022), Eq. 3.1-3.2)."""

from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from uavrl.transforms.reduction import (
    PointCloudReduction,
    Statistic,
    check_points,
    check_radius,
    least_of,
    reported,
    returns_of,
)
from uavrl_onboard.perception.cells import NUM_FACES, TOUCHING, icosahedron, octant

__all__ = [
    "NUM_FACES",
    "TruncatedIcosahedron",
    "TruncatedIcosahedronFaces",
    "truncated_icosahedron",
    "truncated_icosahedron_faces",
]


class TruncatedIcosahedronFaces(NamedTuple):
    """The 32 faces of a truncated icosahedron around the origin.

    Args:
        centres: ``[32, 3]``, face centres in metres: ``offsets * normals``.
        normals: ``[32, 3]``, outward unit normals.
        offsets: ``[32]``, distances from the origin to the face planes in metres.
    """

    centres: Tensor
    normals: Tensor
    offsets: Tensor


@lru_cache(maxsize=64)
@torch.inference_mode(False)  # a cached inference tensor could not serve autograd later
def _faces(radius: float, dtype: torch.dtype, device: torch.device) -> TruncatedIcosahedronFaces:
    normals, offsets = icosahedron(radius)
    exact = (torch.tensor(array, device="cpu") for array in (offsets[:, None] * normals, normals, offsets))
    return TruncatedIcosahedronFaces(*(tensor.to(device=device, dtype=dtype) for tensor in exact))


@lru_cache(maxsize=64)
@torch.inference_mode(False)
def _octant(radius: float, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Return the normals and centres ``[3, 7]`` of one octant's faces, and their images."""
    faces, (first, images) = _faces(radius, torch.float64, torch.device("cpu")), octant()
    normals, centres = (tensor[first].T.contiguous().to(device, dtype) for tensor in (faces.normals, faces.centres))
    return normals, centres, torch.tensor(images, device=device)


def truncated_icosahedron_faces(
    radius: float = 4.0, *, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
) -> TruncatedIcosahedronFaces:
    """Returns the faces in the order in which `truncated_icosahedron` reports them, as tensors that one may change.

    Pentagons come first (0-11), then hexagons (12-31), each group sorted by the z of its centre, lowest first, then by
    azimuth ``atan2(y, x)`` in [0, 2π). Pentagon normals are the cyclic permutations of (0, ±1, ±φ).

    Args:
        radius: circumradius in metres: the distance from the origin to the 60 vertices.
        dtype: of the tensors.
        device: of the tensors.

    Examples:
        >>> faces = truncated_icosahedron_faces(4.0)
        >>> [round(value, 4) for value in (faces.offsets[0].item(), faces.offsets[12].item())]
        [3.7569, 3.6598]
        >>> [round(value, 4) for value in faces.normals[0].tolist()]
        [0.0, 0.5257, -0.8507]
    """
    check_radius(radius)
    return TruncatedIcosahedronFaces(*(t.clone() for t in _faces(float(radius), dtype, torch.device(device))))


def truncated_icosahedron(points: Tensor, radius: float = 4.0, statistic: Statistic = "face") -> Tensor:
    """Reduces point clouds to 32 distances (Chansuparp (2022), Eq. 3.1-3.2).

    A truncated icosahedron whose vertices lie ``radius`` from the origin surrounds the sensor. A point ``p`` is dropped
    if it lies outside any face plane, ``n_i · p > d_i`` (Eq. 3.1; the text has the sign the other way round). Each
    remaining point belongs to the face whose centre ``c_i = d_i n_i`` is nearest, and (Eq. 3.2)

        ``f_i = min ‖p - c_i‖`` over the points of face i, and 0 where it has none.

    0 means "nothing there", so a point that touches its face's centre reads ``1e-6 * radius`` instead. A point equally
    near to two faces goes to either of them. Misses, which are NaN, infinite or zeros, do not count (`is_return`).

    Args:
        points: ``[*B, P, 3]`` in metres, float32 or float64, in the sensor frame (x forward, y left, z up). ``P`` may
            be 0. A layout with x, y and z each contiguous (as `uavrl.envs.lidar.Lidar.scan` returns) is read fastest.
        radius: circumradius in metres.
        statistic: ``"face"`` for the distance to the face's centre (the thesis), ``"range"`` for the distance of the
            face's points to the origin, ``"proximity"`` for ``radius`` less that distance, so that nearer is more and
            nothing is least. All are lengths in metres within [0, ``radius``].

    Returns:
        ``[*B, 32]`` in metres, in the order of `truncated_icosahedron_faces`.

    Raises:
        ValueError: if the shape, the dtype, the radius or the statistic is not as above.

    Examples:
        One point, 3 m from the sensor straight towards pentagon 11, whose centre is 3.7569 m away, and one miss:

        >>> towards = 3.0 * truncated_icosahedron_faces().normals[11]
        >>> faces = truncated_icosahedron(torch.stack([towards, torch.full((3,), torch.nan)]))
        >>> faces.shape, faces.nonzero().tolist(), round(faces[11].item(), 4)
        (torch.Size([32]), [[11]], 0.7569)
    """
    check_points(points, radius, statistic)
    radius = float(radius)
    batch, (_, centres, ids) = points.shape[:-2], _octant(radius, points.dtype, points.device)
    x, y, z, cloud = returns_of(points, radius)
    images = cloud.mul_(8).add_(x < 0.0, alpha=4).add_(y < 0.0, alpha=2).add_(z < 0.0)  # see `_octant`
    x, y, z = x.abs(), y.abs(), z.abs()
    faces, inside = _nearest_face(x, y, z, radius)
    if statistic == "face":
        x, y, z = (at - centre.index_select(0, faces) for at, centre in zip((x, y, z), centres, strict=True))
    lengths = (x * x + y * y + z * z).sqrt().clamp(TOUCHING * radius, radius)
    lengths = torch.where(inside, lengths, torch.inf)
    least = least_of(lengths, images, faces, (batch.numel() * 8, 7)).reshape(*batch, ids.numel())
    out = points.new_full((*batch, NUM_FACES), torch.inf)
    out = out.scatter_reduce(-1, ids.expand_as(least), least, "amin")
    return reported(out, radius, statistic)


def _nearest_face(x: Tensor, y: Tensor, z: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Returns which face of `_octant` is nearest, and whether the point is inside all planes, for M points in it.

    The centre is ``c_i = d_i n_i``, so ``‖p - c_i‖² = ‖p‖² - 2 d_i (n_i · p) + d_i²``: one product ``n · p`` serves
    both tests, and among faces of one kind the greatest is the nearest. The products are summed by hand, which makes
    the result independent of the batch and of PyTorch's matmul precision.
    """
    normals, _, _ = _octant(radius, x.dtype, x.device)
    offsets = _faces(radius, torch.float64, torch.device("cpu")).offsets
    pentagon, hexagon = offsets[0].item(), offsets[-1].item()
    heights = (normals[0, :, None] * x).addcmul_(normals[1, :, None], y).addcmul_(normals[2, :, None], z)  # [7, M]
    (to_pentagon, pentagons), (to_hexagon, hexagons) = heights[:3].max(dim=0), heights[3:].max(dim=0)
    inside = (to_pentagon <= pentagon) & (to_hexagon <= hexagon)
    gap_to_pentagon = pentagon * (pentagon - 2.0 * to_pentagon)  # ‖p - c_i‖² - ‖p‖²
    gap_to_hexagon = hexagon * (hexagon - 2.0 * to_hexagon)
    return torch.where(gap_to_pentagon < gap_to_hexagon, pentagons, hexagons + 3), inside


class TruncatedIcosahedron(PointCloudReduction):
    """Reduces point clouds to the 32 face distances of `truncated_icosahedron`, and drops them.

    The arguments are those of :class:`uavrl.transforms.PointCloudReduction`; ``statistic`` is ``"face"`` by default.

    Examples:
        >>> from tensordict import TensorDict
        >>> reduce = TruncatedIcosahedron(radius=4.0)
        >>> reduce(TensorDict(point_cloud=torch.full((2, 28928, 3), torch.nan), batch_size=[2]))["faces"].shape
        torch.Size([2, 32])
    """

    reduced = staticmethod(truncated_icosahedron)

    @staticmethod
    def directions() -> Tensor:
        """The faces' outward normals ``[32, 3]``."""
        return truncated_icosahedron_faces().normals
