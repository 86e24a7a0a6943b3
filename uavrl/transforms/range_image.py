"""A coarse range image: the scan in cells of azimuth and elevation, as fine as what a VLP-16 sees."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor

from uavrl.transforms.reduction import (
    PointCloudReduction,
    Statistic,
    check_points,
    least_of,
    reported,
    returns_of,
)
from uavrl_onboard.perception.cells import (
    TOUCHING,
    VLP16_GRID,
    RangeGrid,
    range_image_middles,
)

__all__ = ["RangeGrid", "RangeImage", "range_image", "range_image_directions"]


def range_image_directions(
    grid: RangeGrid = VLP16_GRID, *, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
) -> Tensor:
    """Unit vectors ``[cells, 3]`` through the middles of the cells, in the order in which `range_image` reports them.

    Of the default grid: azimuths 0, 15, … 345 degrees (0 is forward, 90 left), and of each the elevations -10, 0 and 10
    degrees.

    Examples:
        >>> range_image_directions()[1].tolist()
        [1.0, 0.0, 0.0]
    """
    return torch.tensor(range_image_middles(grid), device=device, dtype=dtype)


def range_image(
    points: Tensor, radius: float = 4.0, statistic: Statistic = "proximity", grid: RangeGrid = VLP16_GRID
) -> Tensor:
    """Reduces point clouds to 72 distances, one for each cell of 15 degrees of azimuth and one of three elevations.

    A VLP-16 sees 15 degrees up and down. Of the 32 faces of a truncated icosahedron a dozen lie there, each some 40
    degrees wide; these 72 cells all do. Of its 16 lasers the middle row has the four within ±3 degrees, the
    others have six each. The borders of the rows, at ±4 degrees, are a degree from any laser. Points above or below
    belong to the highest and lowest cells; a :class:`RangeImage` with a ``view`` leaves them out. Another ``grid`` has
    other cells, for other sensors.

    Args:
        points: ``[*B, P, 3]``, as in `uavrl.transforms.icosahedron.truncated_icosahedron`.
        radius: of the ball in metres.
        statistic: as there; ``"face"`` is the distance to the point where the cell's middle meets the ball.
        grid: where the cells are.

    Returns:
        ``[*B, 72]``, or ``[*B, grid.count]``, in metres within [0, ``radius``] (``"face"``: cut there), in the order of
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
    shape, radius = (*points.shape[:-2], grid.count), float(radius)
    x, y, z, cloud = returns_of(points, radius)
    across = (x * x + y * y).sqrt()
    column = (torch.atan2(y, x) * (grid.columns / math.tau)).round().long().remainder(grid.columns)
    elevation = torch.atan2(z, across)
    cell = sum(((elevation > math.radians(each)).long() for each in grid.row_borders), column * grid.rows)
    if statistic == "face":
        middles = radius * range_image_directions(grid, dtype=points.dtype, device=points.device)
        x, y, z = (at - middle.index_select(0, cell) for at, middle in zip((x, y, z), middles.T, strict=True))
    lengths = (x * x + y * y).addcmul_(z, z).sqrt().clamp(TOUCHING * radius, radius)
    return reported(least_of(lengths, cloud, cell, shape), radius, statistic)


class RangeImage(PointCloudReduction):
    """Reduces point clouds to the distances of a coarse range image, by default of 72 cells, and drops them.

    Args:
        in_keys, out_keys, radius, statistic, del_keys: as in :class:`uavrl.transforms.PointCloudReduction`;
            ``statistic`` is ``"proximity"`` by default.
        columns, rows, elevation, borders: where the cells are, as in
            :class:`uavrl_onboard.perception.cells.RangeGrid`; elevations in degrees.
            :meth:`for_sensor` chooses them for a sensor.

    Raises:
        UavrlError: as :class:`uavrl_onboard.perception.cells.RangeGrid`.

    Examples:
        >>> from tensordict import TensorDict
        >>> scan = TensorDict(point_cloud=torch.full((2, 28928, 3), torch.nan), batch_size=[2])
        >>> RangeImage()(scan.copy())["faces"].shape
        torch.Size([2, 72])
        >>> RangeImage(columns=36, rows=4, elevation=(-25, 15))(scan)["faces"].shape
        torch.Size([2, 144])
    """

    default_statistic = "proximity"
    reduced = staticmethod(range_image)
    directions = staticmethod(range_image_directions)

    def __init__(
        self,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
        *,
        columns: int = 24,
        rows: int = 3,
        elevation: tuple[float, float] = (-15.0, 15.0),
        borders: Sequence[float] | None = None,
        radius: float = 4.0,
        statistic: Statistic | None = None,
        del_keys: bool = True,
    ) -> None:
        self.grid = RangeGrid(columns, rows, elevation, None if borders is None else tuple(borders))
        if self.grid != VLP16_GRID:  # of this instance; the class's are those of the default grid
            self.reduced = partial(range_image, grid=self.grid)
            self.directions = partial(range_image_directions, self.grid)
        super().__init__(in_keys, out_keys, radius=radius, statistic=statistic, del_keys=del_keys)

    @classmethod
    def for_sensor(cls, rays: Tensor, columns: int = 24, rows: int = 3, **kwargs: Any) -> "RangeImage":
        """Returns a range image for the field of view of a sensor.

        Args:
            rays: directions of its rays ``[R, 3]``, x forward, y left, z up.
            columns: around the sensor.
            rows: of elevation; ``RangeGrid.for_sensor`` chooses where they are.
            **kwargs: as in the constructor.

        Examples:
            >>> from uavrl_onboard.lidar.vlp16 import firing_directions
            >>> RangeImage.for_sensor(torch.from_numpy(firing_directions())).grid == RangeImage().grid
            True
        """
        grid = RangeGrid.for_sensor(torch.as_tensor(rays).detach().cpu().double().numpy(), columns, rows)
        return cls(columns=columns, rows=rows, elevation=grid.elevation, borders=grid.borders, **kwargs)

    def __repr__(self) -> str:
        """Returns the constructor call."""
        grid = {name: value for name, value in vars(self.grid).items() if value != getattr(VLP16_GRID, name)}
        return super().__repr__()[:-1] + "".join(f", {name}={value}" for name, value in grid.items()) + ")"
