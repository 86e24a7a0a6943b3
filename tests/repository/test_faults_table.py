"""The table of faults: what it says of a flight follows from its cycles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.logged import cycles
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.safety import Reason, SafetyState

F, H, S, W = SafetyState.FLYING, SafetyState.HOLDING, SafetyState.SILENT, SafetyState.STANDBY


@pytest.fixture
def faults(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "benchmarks"))
    import faults

    return faults


def flight(*states: SafetyState) -> Iterator[tuple[float, FlightCycle]]:
    reasons = {F: Reason.IN_CONTROL, H: Reason.OLD_SCAN, S: Reason.NO_SCAN, W: Reason.NOT_IN_CONTROL}
    for number, (state, cycle) in enumerate(zip(states, cycles(len(states)), strict=True)):
        status = replace(cycle.status, state=state, reason=reasons[state])
        yield 0.1 * number, replace(cycle, status=status)


@pytest.mark.parametrize(
    ("states", "fault", "told"),
    [
        ((W, F, F, F), 0.2, ("goes on", None, "")),
        ((W, F, F, F, H, H, F), 0.2, ("holds", 0.2, "old_scan")),
        ((W, F, F, H, S, S), 0.2, ("ends", 0.1, "old_scan")),
        ((W, F, H, F, F, H, S), 0.3, ("ends", 0.2, "old_scan")),  # the first was before the fault
        ((S, S, S, W), None, ("never begins", None, "no_scan")),
        ((W, F, H, F), None, ("holds", None, "old_scan")),
    ],
)
def test_what_a_flight_answers(states: Any, fault: float | None, told: Any, faults: Any) -> None:
    verdict, after, reason = faults.answer(flight(*states), fault)
    assert (verdict, reason) == (told[0], told[2]) and after == (told[1] and pytest.approx(told[1]))


def test_the_table(faults: Any) -> None:
    row = {"fault": "a", "verdict": "holds", "zeros_after": 0.125, "reason": "old_scan", "outcome": "time_out"}
    quiet = row | {"verdict": "never begins", "zeros_after": None, "outcome": None}
    lines = faults.table([row, quiet]).splitlines()[2:]
    assert lines[0] == "| a | holds | 0.12 s | `old_scan` | time-out |"
    assert lines[1] == "| a | never begins |  | `old_scan` | nothing was obeyed |"


def test_each_fault_has_a_name_of_its_own(faults: Any) -> None:
    names = [fault.name for fault in faults.FAULTS]
    assert len(names) == len(set(names)) and names[0] == "none"
