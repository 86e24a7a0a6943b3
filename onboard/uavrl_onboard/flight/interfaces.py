"""What the flight's loop asks of a source of scans and of a vehicle, whatever they are behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.autopilot.vehicle_state import VehicleStatus
from uavrl_onboard.flight.safety import SafetyStatus
from uavrl_onboard.lidar.scans import Scan, Skipped


class ScanFeed(Protocol):
    """Scans as they come: packets by UDP, clouds of another process, a recording. Nothing waits in it."""

    skipped: Skipped  #: how much was left out so far, by reason

    def poll(self, now: float) -> Scan | None:
        """The newest scan that has come since the last call, stamped on the loop's clock; ``None`` for no new one.

        Args:
            now: the loop's clock, s.
        """

    def trouble(self) -> str:
        """Why no scan came out, as a sentence's second half."""

    def remarks(self) -> list[str]:
        """What the user should know of the source, though scans come."""

    def fileno(self) -> int | None:
        """What the system can wait for, ``None`` where there is no such thing."""

    def close(self) -> None:
        """Gives back what it has opened."""


class VehicleLink(Protocol):
    """The way to a vehicle and back; `uavrl_onboard.autopilot.mavlink.Autopilot` is one. Nothing waits in it."""

    def receive(self, now: float) -> None:
        """Reads all that has come."""

    def pose(self) -> Pose | None:
        """Where the vehicle was last; ``None`` before it has told."""

    def status(self, now: float) -> VehicleStatus:
        """Who flies the vehicle."""

    def send(self, setpoint: Sequence[float] | np.ndarray | None, now: float) -> None:
        """Sends a set-point (l_x, l_y, l_z, a_z), or none, and what else is due: called once a cycle."""

    def fileno(self) -> int | None:
        """What the system can wait for, ``None`` where there is no such thing."""

    def close(self) -> None:
        """Gives back what it has opened."""


@dataclass(frozen=True)
class FlightCycle:
    """All that is known of one cycle of a flight: what the status line shows and the log keeps."""

    time: float  #: of the loop's clock, s
    scan: Scan | None  #: without the points on the vehicle; ``None`` where none has come since the last cycle
    cells: np.ndarray | None  #: ``[cells]``, what the policy sees of that scan, m
    pose: Pose | None
    distance: float | None  #: to the goal, horizontally, m
    action: np.ndarray | None  #: ``[4]``, of the policy, before the safety layer
    control: VehicleStatus
    status: SafetyStatus
    latency: float | None  #: from the scan's last packet to the set-point, s; ``None`` without a new scan
    arrived: bool = False  #: whether the vehicle is, or has been, at the goal, by plausible poses
    turn: float | None = None  #: how far off the goal's direction the memory led the policy, rad; ``None`` for not
    doubt: str | None = None  #: what is odd about the latest scans, which may have an innocent reason
