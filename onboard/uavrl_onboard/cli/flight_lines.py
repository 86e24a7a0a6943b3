"""The lines that ``uavrl-fly`` prints while it flies."""

from __future__ import annotations

import numpy as np

from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.safety import Reason, SafetyState
from uavrl_onboard.flight.summary import FlightSummary
from uavrl_onboard.geometry import is_return

AGAIN = 5.0  # s after which a reason is told again that comes and goes within one state
EACH_SECOND = 10.0  # s of silence in which there is a line each second; then there is one in as many
_WAITS = (Reason.NO_SCAN, Reason.OLD_SCAN, Reason.NO_POSE, Reason.OLD_POSE)


class FlightLines:
    """A line for each change of state, and one each second; fewer where nothing is flown for want of scans or poses."""

    def __init__(self) -> None:
        self._state: SafetyState | None = None
        self._told: dict[Reason, float] = {}  # in this state
        self._waits_since: float | None = None
        self._line_at = 0.0  # of the latest line that was due by its second

    def of(self, cycle: FlightCycle, summary: FlightSummary) -> str | None:
        """What is to be printed of a cycle; ``None`` for nothing."""
        status, seconds = cycle.status, summary.seconds
        if status.state is not self._state:
            self._state, self._told = status.state, {}
        waits = status.state is SafetyState.SILENT and status.reason in _WAITS
        self._waits_since = None if not waits else seconds if self._waits_since is None else self._waits_since
        if status.changed and seconds - self._told.get(status.reason, -AGAIN) >= AGAIN:
            self._told[status.reason] = seconds
            return f"{seconds:7.1f} s  {status.state} ({status.reason}): {status.sentence}"
        long = self._waits_since is not None and seconds - self._waits_since > EACH_SECOND
        if not summary.is_new_second or (long and int(seconds) - int(self._line_at) < EACH_SECOND):
            return None
        self._line_at = seconds
        return f"{seconds:7.1f} s  {status.state}  {_known(cycle, summary)}"


def _known(cycle: FlightCycle, summary: FlightSummary) -> str:
    """What is known of one cycle: rate, ages, nearest return, way to the goal, set-point."""
    told = [f"{summary.rate:4.1f} Hz"]
    told += [
        f"{name} {_age(age)} old"
        for name, age in (("scan", cycle.status.scan_age), ("pose", cycle.status.pose_age))
        if age is not None
    ]
    if cycle.scan is not None:
        points = cycle.scan.points[is_return(cycle.scan.points)]
        told.append(f"nearest {np.sqrt((points**2).sum(-1)).min():.2f} m" if len(points) else "nothing near")
    if cycle.distance is not None:
        told.append(f"goal {cycle.distance:.1f} m")
    if cycle.turn:
        told.append(f"way {abs(np.degrees(cycle.turn)):.0f}° {'left' if cycle.turn > 0 else 'right'} of it")
    if cycle.status.setpoint is not None:
        forward, left, up, turn = cycle.status.setpoint
        told.append(f"forward {forward:+.2f} left {left:+.2f} up {up:+.2f} m/s turn {turn:+.2f} rad/s")
    return "  ".join(told)


def _age(age: float) -> str:
    return f"{1000 * age:3.0f} ms" if age < 1.0 else f"{age:.1f} s"
