"""The keys of what reads a LiDAR."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from uavrl_onboard.flight.log_messages import POINTS
from uavrl_onboard.lidar.mount import UPRIGHT, mount_rotation, mount_trouble
from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.ranges import Folder, Text
from uavrl_onboard.sentences import require


@dataclass
class LidarKeys:
    """The sensor, how it is mounted, and the box around the vehicle whose points are left out.

    Args:
        model: Velodyne that sends the packets: VLP16, PuckHiRes, HDL32E, VLP32A, VLP32B or VLP32C; a PointCloud2
            needs none
        metadata: file with the metadata of the Ouster that sends the packets, instead of model
        topic: topic of a ROS recording that has several topics with scans
        product: product byte of the packets, if the sensor carries another than its model's, e.g. 33
        mount: [roll,pitch,yaw] of the LiDAR in the vehicle's axes in degrees, as in a URDF: [180,0,0] upside down,
            [0,20,0] tilted forward and down, [0,0,90] turned to the left
        vehicle: box around the vehicle whose points are left out, in m from the sensor along the vehicle's axes: least
            corner, greatest corner, e.g. [-0.4,-0.4,-0.4,0.4,0.4,0.1]
    """

    model: Text | None = None
    metadata: Folder | None = None
    topic: Text | None = None
    product: Annotated[int, Field(ge=0, le=255)] | None = None
    mount: tuple[float, ...] = UPRIGHT
    vehicle: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        """Checks mount and box."""
        trouble = mount_trouble(self.mount)
        require(trouble is None, "mount", str(trouble), self.mount)
        box = self.box
        whole = self.vehicle is None or (box is not None and bool((box[0] < box[1]).all()))
        require(whole, "vehicle", "six numbers: the box's least corner, then its greatest", self.vehicle)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The corners of the box around the vehicle, from the sensor in m; ``None`` for no box."""
        if self.vehicle is None or len(self.vehicle) != 6:
            return None
        return np.array(self.vehicle[:3]), np.array(self.vehicle[3:])

    def require_unturned(self, source: ScanSource) -> None:
        """Refuses to turn the points of a flight log once more."""
        again = self.rotation is not None and source.topic is not None and source.topic.name == POINTS
        told = "left out for a flight log, whose points are in the vehicle's axes"
        require(not again, "mount", told, list(self.mount))

    @property
    def rotation(self) -> np.ndarray | None:
        """From the LiDAR's axes to the vehicle's, ``[3, 3]``; ``None`` where they are the same."""
        return None if self.mount == UPRIGHT else mount_rotation(self.mount)
