"""What became of a flight, in a few numbers."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any

import numpy as np

from uavrl_onboard.flight.interfaces import FlightCycle


class FlightSummary:
    """Adds the cycles of a flight up.

    Attributes:
        cycles: how many there were.
        changes: ``(s since the first cycle, state, reason, sentence)`` of each change of the safety layer.
        is_new_second: whether the latest cycle is the first of a second.
    """

    def __init__(self) -> None:
        self.cycles, self.scans = 0, 0
        self.changes: list[tuple[float, str, str, str]] = []
        self._first, self._last = 0.0, 0.0
        self._arrived: float | None = None
        self._least = np.inf
        self._latencies: list[float] = []
        self._states: Counter[str] = Counter()
        self._recent: deque[float] = deque(maxlen=11)  # stamps of scans
        self.is_new_second = False

    def add(self, cycle: FlightCycle) -> None:
        """Adds a cycle."""
        self._first = cycle.time if self.cycles == 0 else self._first
        self.is_new_second = int(cycle.time - self._first) > int(self.seconds)
        self._last, self.cycles, self.scans = cycle.time, self.cycles + 1, self.scans + (cycle.scan is not None)
        if not cycle.arrived:  # or not any more: the pose has jumped
            self._arrived = None
        elif self._arrived is None:
            self._arrived = self.seconds
        if cycle.distance is not None and np.isfinite(cycle.distance):
            self._least = min(self._least, cycle.distance)
        if cycle.scan is not None:
            self._recent.append(cycle.scan.stamp)
        if cycle.latency is not None:
            self._latencies.append(cycle.latency)
        status = cycle.status
        self._states[status.state.value] += 1
        if status.changed:
            self.changes.append((round(self.seconds, 3), status.state.value, status.reason.value, status.sentence))

    @property
    def seconds(self) -> float:
        """From the first to the latest cycle."""
        return self._last - self._first

    @property
    def rate(self) -> float:
        """Scans a second, of the latest."""
        span = self._recent[-1] - self._recent[0] if self._recent else 0.0
        return (len(self._recent) - 1) / span if span > 0.0 else 0.0

    def facts(self) -> dict[str, Any]:
        """The numbers by name; ``None`` where there is none.

        ``latency_ms`` is from the arrival of a scan's last packet to the set-point.
        """
        latency = 1000.0 * np.array(self._latencies)
        middle, late = (np.percentile(latency, share).round(3).tolist() if len(latency) else None for share in (50, 99))
        return {
            "arrived": self._arrived is not None,
            "arrived_after_s": None if self._arrived is None else round(self._arrived, 3),
            "least_distance_m": round(float(self._least), 3) if np.isfinite(self._least) else None,
            "seconds": round(self.seconds, 3),
            "cycles": self.cycles,
            "scans": self.scans,
            "latency_ms": {"median": middle, "p99": late},
            "cycles_in_state": dict(self._states),
            "changes": [list(change) for change in self.changes],
        }
