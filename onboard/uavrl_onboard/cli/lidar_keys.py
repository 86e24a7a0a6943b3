"""The keys of what reads a LiDAR."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from uavrl_onboard.ranges import Folder, Text
from uavrl_onboard.sentences import require


@dataclass
class LidarKeys:
    """The sensor, and the box around the vehicle whose points are left out.

    Args:
        model: Velodyne that sends the packets: VLP16, PuckHiRes, HDL32E, VLP32A, VLP32B or VLP32C; a PointCloud2
            needs none
        metadata: file with the metadata of the Ouster that sends the packets, instead of model
        topic: topic of a ROS recording that has several topics with scans
        product: product byte of the packets, if the sensor carries another than its model's, e.g. 33
        vehicle: box around the vehicle whose points are left out, in m from the sensor: least corner, greatest corner,
            e.g. [-0.4,-0.4,-0.4,0.4,0.4,0.1]
    """

    model: Text | None = None
    metadata: Folder | None = None
    topic: Text | None = None
    product: Annotated[int, Field(ge=0, le=255)] | None = None
    vehicle: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        """Checks the box."""
        box = self.box
        whole = self.vehicle is None or (box is not None and bool((box[0] < box[1]).all()))
        require(whole, "vehicle", "six numbers: the box's least corner, then its greatest", self.vehicle)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The corners of the box around the vehicle, from the sensor in m; ``None`` for no box."""
        if self.vehicle is None or len(self.vehicle) != 6:
            return None
        return np.array(self.vehicle[:3]), np.array(self.vehicle[3:])
