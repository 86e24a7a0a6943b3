"""The keys of what reads a LiDAR."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from uavrl.config.sentences import require
from uavrl.ranges import Text


@dataclass
class LidarKeys:
    """Which sensor sends, and which of its points lie on the vehicle."""

    model: Text | None = None
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
