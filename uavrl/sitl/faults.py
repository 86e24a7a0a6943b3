"""What may go wrong between a sensor, an autopilot and a companion: for tests and rehearsals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uavrl.errors import UavrlError

Span = tuple[float, float]


@dataclass
class Faults:
    """Faults of the way; times are in s from the first set-point that was obeyed.

    Args:
        lose: share of the LiDAR's packets that are lost.
        reorder: share of them that come after the next one.
        lidar_silent: from when to when the LiDAR sends nothing.
        pose_silent: from when to when the autopilot does not say where the vehicle is.
        product: product byte of the LiDAR's packets.
        seed: of what is lost.

    Examples:
        >>> faults = Faults(lidar_silent=(1.0, 2.0), product=0x21)
        >>> faults.of_lidar([bytes(1206)], 1.5), faults.of_lidar([bytes(1206)], 2.0)[0][-1]
        ([], 33)
    """

    lose: float = 0.0
    reorder: float = 0.0
    lidar_silent: tuple[float, float] | None = None
    pose_silent: tuple[float, float] | None = None
    product: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks what the shares and times say."""
        for name in ("lose", "reorder"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise UavrlError(f"faults.{name} must be a share in [0, 1], got {getattr(self, name)}.")
        for name in ("lidar_silent", "pose_silent"):
            span = getattr(self, name)
            if span is not None and not 0.0 <= span[0] <= span[1]:
                raise UavrlError(f"faults.{name} must be two times in s from 0, the earlier first, got {list(span)}.")
        if self.product is not None and not 0 <= self.product < 256:
            raise UavrlError(f"faults.product must be a byte, 0 to 255, got {self.product}.")
        if self.seed < 0:
            raise UavrlError(f"faults.seed must be a whole number from 0, got {self.seed}.")
        self._rng = np.random.default_rng(self.seed)
        self._kept: list[bytes] = []

    def of_lidar(self, packets: Sequence[bytes], since: float | None) -> list[bytes]:
        """What arrives of some packets, ``since`` s after the first obeyed set-point (None: there was none yet)."""
        if _within(self.lidar_silent, since):
            return []
        arrived: list[bytes] = []
        for packet in packets:
            if self.product is not None:
                packet = packet[:-1] + bytes([self.product])
            if self._rng.random() < self.lose:
                continue
            kept, self._kept = self._kept, []
            if not kept and self._rng.random() < self.reorder:
                self._kept = [packet]
            else:
                arrived += [packet, *kept]
        return arrived

    def hides_pose(self, since: float | None) -> bool:
        """Whether the pose is not told."""
        return _within(self.pose_silent, since)


def _within(span: Span | None, since: float | None) -> bool:
    return span is not None and since is not None and span[0] <= since < span[1]
