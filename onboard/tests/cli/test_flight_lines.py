"""What ``uavrl-fly`` prints of its cycles, and how often."""

from __future__ import annotations

from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.cli.flight_lines import FlightLines
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.safety import Reason, SafetyState, SafetyStatus
from uavrl_onboard.flight.summary import FlightSummary


def printed(*states: tuple[SafetyState, Reason], pose_age: float = 0.12) -> list[str]:
    """The lines of cycles of 0.1 s in these states."""
    lines, summary, found = FlightLines(), FlightSummary(), []
    control = VehicleStatus(Control.OTHER_MODE, "")
    for number, state in enumerate(states):
        changed = number == 0 or state != states[number - 1]
        status = SafetyStatus(0.1 * number, *state, "why", changed, 0.0, None, (), None, pose_age)
        cycle = FlightCycle(0.1 * number, None, None, None, None, None, control, status, None)
        summary.add(cycle)
        if (line := lines.of(cycle, summary)) is not None:
            found.append(line.strip())
    return found


OLD, SETTLING = (SafetyState.SILENT, Reason.OLD_POSE), (SafetyState.SILENT, Reason.SETTLING)


def test_a_reason_that_comes_and_goes_is_told_every_five_seconds() -> None:
    told = [line for line in printed(*[OLD, SETTLING] * 55) if "(" in line]
    assert told == [
        "0.0 s  silent (old_pose): why",
        "0.1 s  silent (settling): why",
        "5.0 s  silent (old_pose): why",
        "5.1 s  silent (settling): why",
        "10.0 s  silent (old_pose): why",
        "10.1 s  silent (settling): why",
    ]


def test_a_new_state_is_told_at_once() -> None:
    flying, holding = (SafetyState.FLYING, Reason.IN_CONTROL), (SafetyState.HOLDING, Reason.OLD_POSE)
    told = [line for line in printed(flying, holding, flying, holding) if "(" in line]
    assert [line.split()[2] for line in told] == ["flying", "holding", "flying", "holding"]


def test_a_wait_that_lasts_has_fewer_lines_and_what_is_well_one_each_second() -> None:
    waited = printed(*[OLD] * 420, pose_age=12.34)
    assert waited[1] == "1.0 s  silent   0.0 Hz  pose 12.3 s old"
    assert [line.split()[0] for line in waited[1:]] == [*(f"{n}.0" for n in range(1, 11)), "20.0", "30.0", "40.0"]
    outside = printed(*[(SafetyState.SILENT, Reason.OUTSIDE_FENCE)] * 305)
    assert len(outside) == 31 and outside[-1] == "30.0 s  silent   0.0 Hz  pose 120 ms old"
