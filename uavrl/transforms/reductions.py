"""The reductions of a scan by the names that choose them."""

from typing import Literal

from uavrl.transforms.point_cloud_reduction import PointCloudReduction
from uavrl.transforms.range_image import RangeImage
from uavrl.transforms.truncated_icosahedron import TruncatedIcosahedron

__all__ = ["REDUCTIONS", "Reduction"]

Reduction = Literal["truncated_icosahedron", "range_image"]

REDUCTIONS: dict[Reduction, type[PointCloudReduction]] = {
    "truncated_icosahedron": TruncatedIcosahedron,
    "range_image": RangeImage,
}
