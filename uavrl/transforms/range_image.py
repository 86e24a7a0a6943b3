"""A coarse range image: the scan in cells of azimuth and elevation, as fine as what a VLP-16 sees."""

import math

import torch
from torch import Tensor

from uavrl.transforms.reduction import (
    PointCloudReduction,
    Statistic,
    check_points,
    least_of,
    reported,
    returns_of,
)
from uavrl_onboard.perception.cells import AZIMUTHS, ELEVATIONS, ROW_BORDERS, TOUCHING, range_image_middles

__all__ = ["AZIMUTHS", "ELEVATIONS", "RangeImage", "range_image", "range_image_directions"]


def range_image_directions(*, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu") -> Tensor:
    """Unit vectors ``[72, 3]`` through the middles of the cells, in the order in which `range_image` reports them.

    Azimuths 0, 15, … 345 degrees (0 is forward, 90 left), and of each the elevations -10, 0 and 10 degrees.

    Examples:
        >>> range_image_directions()[1].tolist()
        [1.0, 0.0, 0.0]
    """
    return torch.tensor(range_image_middles(), device=device, dtype=dtype)


def range_image(points: Tensor, radius: float = 4.0, statistic: Statistic = "proximity") -> Tensor:
    """Reduces point clouds to 72 distances, one for each cell of 15 degrees of azimuth and one of three elevations.

    A VLP-16 sees 15 degrees up and down. Of the 32 faces of a truncated icosahedron a dozen lie there, each some 40
    degrees wide; these 72 cells all do. Of its 16 lasers the middle row has the four within ±3 degrees, the
    others have six each; points above or below belong to the highest and lowest cells. The borders of the rows, at ±4
    degrees, are a degree from any laser.

    Args:
        points: ``[*B, P, 3]``, as in `uavrl.transforms.icosahedron.truncated_icosahedron`.
        radius: of the ball in metres.
        statistic: as there; ``"face"`` is the distance to the point where the cell's middle meets the ball.

    Returns:
        ``[*B, 72]`` in metres within [0, ``radius``] (``"face"``: cut there), in the order of
        `range_image_directions`.

    Raises:
        ValueError: if the shape, the dtype, the radius or the statistic is not as above.

    Examples:
        One point 3 m ahead and one miss:

        >>> image = range_image(torch.tensor([[3.0, 0.0, 0.0], [torch.nan] * 3]))
        >>> image.shape, image.nonzero().tolist(), image[1].item()
        (torch.Size([72]), [[1]], 1.0)
    """
    check_points(points, radius, statistic)
    shape, radius = (*points.shape[:-2], AZIMUTHS * ELEVATIONS), float(radius)
    x, y, z, cloud = returns_of(points, radius)
    across = (x * x + y * y).sqrt()
    column = (torch.atan2(y, x) * (AZIMUTHS / math.tau)).round().long().remainder(AZIMUTHS)
    elevation = torch.atan2(z, across)
    cell = sum(((elevation > border).long() for border in ROW_BORDERS), column * ELEVATIONS)
    if statistic == "face":
        middles = radius * range_image_directions(dtype=points.dtype, device=points.device)
        x, y, z = (at - middle.index_select(0, cell) for at, middle in zip((x, y, z), middles.T, strict=True))
    lengths = (x * x + y * y).addcmul_(z, z).sqrt().clamp(TOUCHING * radius, radius)
    return reported(least_of(lengths, cloud, cell, shape), radius, statistic)


class RangeImage(PointCloudReduction):
    """Reduces point clouds to the 72 distances of a coarse range image, and drops them.

    The arguments are those of :class:`uavrl.transforms.PointCloudReduction`; ``statistic`` is ``"proximity"`` by
    default.

    Examples:
        >>> from tensordict import TensorDict
        >>> reduce = RangeImage()
        >>> reduce(TensorDict(point_cloud=torch.full((2, 28928, 3), torch.nan), batch_size=[2]))["faces"].shape
        torch.Size([2, 72])
    """

    default_statistic = "proximity"
    reduced = staticmethod(range_image)
    directions = staticmethod(range_image_directions)
