"""A link to no vehicle at all, for a dry run: it stands still and swallows set-points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uavrl_onboard.autopilot.frames import Pose, Vector
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus


class DryRun:
    """A vehicle that is at one place and goes nowhere, for a LiDAR at a desk and for recordings.

    Args:
        position: x, y, z in the world's axes, m.
        yaw: from x to the left, rad.

    Examples:
        >>> link = DryRun((0.0, 0.0, 3.5))
        >>> link.receive(now=2.0)
        >>> link.pose().stamp, link.status(2.0).control.value
        (2.0, 'in_control')
    """

    def __init__(self, position: Vector, yaw: float = 0.0) -> None:
        self._position, self._yaw, self._now = position, yaw, 0.0

    def receive(self, now: float) -> None:
        """Notes the time, which is that of the pose."""
        self._now = now

    def pose(self) -> Pose:
        """Where it is."""
        return Pose(self._now, self._position, (0.0, 0.0, 0.0), self._yaw)

    def status(self, now: float) -> VehicleStatus:
        """The policy flies, into nothing."""
        return VehicleStatus(Control.IN_CONTROL, "a dry run: set-points are sent to nobody")

    def send(self, setpoint: Sequence[float] | np.ndarray | None, now: float) -> None:
        """Sends nothing."""

    def fileno(self) -> None:
        """There is nothing to wait for."""

    def close(self) -> None:
        """There is nothing to close."""
