"""How a flight by ``uavrl-fly`` ends: when, what is told, and what is written."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, cast

from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.files import replacing
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.log import FlightLog
from uavrl_onboard.flight.summary import FlightSummary
from uavrl_onboard.pluralize import pluralize


def until_the_end(cycles: Iterable[FlightCycle], hold: float | None, seconds: float | None) -> Iterator[FlightCycle]:
    """The cycles until the vehicle has hovered at the goal for long enough, was taken over there, or time is up.

    Args:
        cycles: of the flight.
        hold: time of hovering at the goal, s; None: for ever.
        seconds: time after which the flight ends, s; None: never.
    """
    first, arrived = None, None
    for cycle in cycles:
        yield cycle
        first = cycle.time if first is None else first
        arrived = cycle.time if arrived is None and cycle.arrived else arrived
        arrived = arrived if cycle.arrived else None
        hovered = arrived is not None and hold is not None and cycle.time - arrived >= hold
        taken_over = arrived is not None and cycle.control.control in (Control.TAKEN_OVER, Control.DISARMED)
        if hovered or taken_over or (seconds is not None and cycle.time - first >= seconds):
            return


def writes(summary: FlightSummary, path: Path) -> Callable[[object, BaseException | None, object], None]:
    """Returns what writes the numbers of a flight that has begun, at its end; an error of the flight comes first."""

    def write(_kind: object, error: BaseException | None, _trace: object) -> None:
        if not summary.cycles:
            return
        try:
            with replacing(path) as partial:
                partial.write_text(json.dumps(summary.facts(), indent=2) + "\n", encoding="utf-8")
        except OSError as failure:
            if error is None:
                raise
            print(f"uavrl: {path} was not written ({failure.strerror}).", file=sys.stderr)
        else:
            print(f"Written to {path}")

    return write


def conclude(facts: dict[str, Any], log: FlightLog | None) -> None:
    """Says how it ended, before any file is written: a disk may be full."""
    after = cast(float | None, facts["arrived_after_s"])
    ended = "it did not arrive" if after is None else f"it arrived after {after:.1f} s"
    least = f", {facts['least_distance_m']:.1f} m from the goal at the nearest" if facts["least_distance_m"] else ""
    print(f"{facts['seconds']:.1f} s, {pluralize(facts['scans'], 'scan')}: {ended}{least}.")
    if (latency := facts["latency_ms"])["median"] is not None:
        print(
            f"From a scan's last packet to the set-point: {latency['median']:.1f} ms (median), "
            f"{latency['p99']:.1f} ms (99 %)."
        )
    if log is not None:
        print(f"Log: {log.path}, which uavrl-replay flight={log.path} shows", flush=True)
