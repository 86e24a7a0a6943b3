"""The safety layer between a policy and the autopilot: a state machine without sockets and without a clock.

In each cycle, `SafetyLayer.step` receives the time, the policy's action, and the age and numbers of scan and pose. It
returns a record with the state, the reason and the set-point. If the set-point is None, nothing may be sent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from uavrl_onboard.enums import StrEnum
from uavrl_onboard.flight.limits import SafetyLimits, distance_outside, limit
from uavrl_onboard.vehicle import VEHICLE

SetPoint = tuple[float, float, float, float]
"""Velocities forward, left and up in m/s and the yaw rate to the left in rad/s, as in a policy's action."""

ZEROS: SetPoint = (0.0, 0.0, 0.0, 0.0)
_ROUNDING = 1e-6  # s, so that rounding does not push an age over its limit
_AHEAD = 0.05  # s by which a stamp may be later than the time of the cycle
_CYCLE = VEHICLE.period  # s, assumed for a cycle in which the clock did not advance


class SafetyState(StrEnum):
    """The states of the layer."""

    SILENT = "silent"  #: It sends nothing, so the autopilot refuses Offboard or leaves it.
    STANDBY = "standby"  #: It sends zeros, since the autopilot does not fly by set-points; all rules hold.
    FLYING = "flying"  #: It sends the policy's action within its limits.
    FENCED = "fenced"  #: It sends the action without the part that leads out of the fence.
    HOLDING = "holding"  #: It sends zeros, because a rule is broken or was broken a moment ago.


class Reason(StrEnum):
    """The reasons for a state."""

    STARTING = "starting"
    SETTLING = "settling"  #: all rules hold, but not yet for long enough
    NOT_IN_CONTROL = "not_in_control"
    IN_CONTROL = "in_control"
    FLOOR = "floor"
    CEILING = "ceiling"
    WALL = "wall"
    CLOCK = "clock"
    LATE_CYCLE = "late_cycle"
    NO_SCAN = "no_scan"
    OLD_SCAN = "old_scan"
    SCAN_AHEAD = "scan_ahead"
    NO_POSE = "no_pose"
    OLD_POSE = "old_pose"
    POSE_AHEAD = "pose_ahead"
    POSE_NOT_FINITE = "pose_not_finite"
    POSITION_FAR = "position_far"  #: farther from the origin than any vehicle flies
    POSITION_JUMPED = "position_jumped"
    YAW_JUMPED = "yaw_jumped"
    POSE_RESET = "pose_reset"  #: the autopilot reports a reset of its estimator
    VELOCITY_DISAGREES = "velocity_disagrees"  #: the velocity disagrees with the position
    EMPTY_SCANS = "empty_scans"
    ODD_RANGES = "odd_ranges"  #: no LiDAR measures such ranges
    HALF_SCAN = "half_scan"  #: the scan covers less than its sensor's field of view
    SCANS_DISAGREE = "scans_disagree"  #: the scans disagree with the pose
    OUTSIDE_FENCE = "outside_fence"
    NO_ACTION = "no_action"
    ACTION_NOT_FINITE = "action_not_finite"


@dataclass(frozen=True)
class Cycle:
    """The inputs of one cycle. All times are in seconds of one monotonic clock (``time.monotonic``)."""

    now: float
    action: Sequence[float] | np.ndarray | None  #: the policy's action (l_x, l_y, l_z, a_z)
    scan_stamp: float | None  #: when the last packet arrived of the scan that the action is based on
    pose_stamp: float | None  #: when the older of position and yaw arrived
    position: Sequence[float] | np.ndarray | None  #: x, y, z in the world's axes, m
    yaw: float | None  #: in the same axes, rad
    in_control: bool  #: whether the autopilot flies by set-points
    implausible: tuple[Reason, str] | None = None  #: why a scan or pose is implausible though it is fresh and finite


@dataclass(frozen=True)
class SafetyStatus:
    """The record of one cycle."""

    time: float  #: of the cycle, s
    state: SafetyState
    reason: Reason
    sentence: str  #: the reason in words
    changed: bool  #: whether the state or the reason differs from the previous cycle's
    since: float  #: when the state began, s
    setpoint: SetPoint | None  #: None if nothing may be sent
    limited: tuple[str, ...]  #: which of ``clip``, ``slew`` and ``fence`` changed the action
    scan_age: float | None  #: s
    pose_age: float | None  #: s

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON can store it."""
        return asdict(self)


_Why = tuple[Reason, str]


class SafetyLayer:
    """The state machine whose table is in docs/safety_layer.md.

    Args:
        limits: the limits of ages, velocities, changes and positions.

    Examples:
        >>> layer, position = SafetyLayer(), (0.0, 0.0, 3.5)
        >>> for tenth in range(12):
        ...     now = tenth / 10
        ...     status = layer.step(Cycle(now, (1, 0, 0, 0), now, now, position, yaw=0.0, in_control=True))
        ...     if status.changed:
        ...         print(now, status.state, status.reason, status.setpoint)
        0.0 silent settling None
        1.0 standby settling (0.0, 0.0, 0.0, 0.0)
        1.1 flying in_control (1.0, 0.0, 0.0, 0.0)
    """

    def __init__(self, limits: SafetyLimits | None = None) -> None:
        self.limits = limits or SafetyLimits()
        self._state, self._reason, self._since = SafetyState.SILENT, Reason.STARTING, 0.0
        self._now: float | None = None
        self._sane_since: float | None = None  # when all rules began to hold
        self._sent = np.zeros(4)
        self._clockless = 0  # consecutive cycles in which the clock did not advance

    def step(self, cycle: Cycle) -> SafetyStatus:
        """Return what may be sent in this cycle, and why."""
        fault, elapsed = self._advance(cycle.now)
        self._clockless = self._clockless + 1 if fault and fault[0] is Reason.CLOCK else 0
        now = self._now or 0.0
        ages = _age(now, cycle.scan_stamp), _age(now, cycle.pose_stamp)
        action, place = _numbers(cycle.action, 4), _numbers(cycle.position, 3)
        yaw = _numbers([cycle.yaw], 1)
        fault = fault or self._stale(*ages) or _no_pose(place, yaw) or cycle.implausible
        fault = fault or self._outside(place) or _unfit(action)
        self._sane_since = None if fault else now if self._sane_since is None else self._sane_since
        state, (reason, sentence) = self._next(now, fault, cycle.in_control)
        setpoint: SetPoint | None = None if state is SafetyState.SILENT else ZEROS
        by: tuple[str, ...] = ()
        if state is SafetyState.FLYING:
            assert action is not None and place is not None and yaw is not None
            found, by, side = limit(action, self._sent, elapsed, place, float(yaw[0]), self.limits)
            setpoint = tuple(found.tolist())
            if side is not None:
                state, reason, sentence = (
                    SafetyState.FENCED,
                    Reason(side),
                    f"the fence's {side} is near: slower towards it",
                )
        self._sent = np.array(setpoint or ZEROS)
        changed = (state, reason) != (self._state, self._reason)
        self._since = self._since if state is self._state and self._reason is not Reason.STARTING else now
        self._state, self._reason = state, reason
        return SafetyStatus(now, state, reason, sentence, changed, self._since, setpoint, by, *ages)

    def _next(self, now: float, fault: _Why | None, in_control: bool) -> tuple[SafetyState, _Why]:
        """Return the next state and its reason, before the fence is considered."""
        limits = self.limits
        if fault:
            if self._state is SafetyState.SILENT:
                return SafetyState.SILENT, fault
            held = now - self._since + _CYCLE * max(self._clockless - 1, 0)
            if self._state is SafetyState.HOLDING and held >= limits.hold - _ROUNDING:
                return SafetyState.SILENT, (fault[0], f"{fault[1]}, and zeros were sent for {limits.hold:g} s")
            return SafetyState.HOLDING, fault
        assert self._sane_since is not None
        waits = {SafetyState.SILENT: limits.return_after_silence, SafetyState.HOLDING: limits.recovery}.get(
            self._state, 0.0
        )
        if now - self._sane_since < waits - _ROUNDING:
            return self._state, (Reason.SETTLING, f"all rules must hold for {waits:g} s first")
        if self._state is SafetyState.SILENT:
            return SafetyState.STANDBY, (Reason.SETTLING, f"all rules have held for {waits:g} s")
        if not in_control:
            return SafetyState.STANDBY, (Reason.NOT_IN_CONTROL, "the autopilot does not fly by set-points")
        return SafetyState.FLYING, (Reason.IN_CONTROL, "the policy flies")

    def _advance(self, now: float) -> tuple[_Why | None, float]:
        """Advance the layer's time; return what is wrong with the clock, and the time since the last cycle in s."""
        number, before = _numbers([now], 1), self._now
        if number is None or not np.isfinite(number[0]) or (before is not None and number[0] < before):
            return (Reason.CLOCK, f"the clock went from {before} to {now!r}"), 0.0
        self._now = float(number[0])
        elapsed = 0.0 if before is None else self._now - before
        if elapsed > self.limits.scan_age + _ROUNDING:
            return (Reason.LATE_CYCLE, f"the cycle before was {elapsed:.2f} s ago"), elapsed
        return None, elapsed

    def _stale(self, scan_age: float | None, pose_age: float | None) -> _Why | None:
        """Return what is wrong with the ages of scan and pose; None if nothing is."""
        no_scan, no_pose = "there is no scan", "the autopilot has sent no position and attitude"
        for what, age, most, none, missing, old, ahead in (
            ("scan", scan_age, self.limits.scan_age, Reason.NO_SCAN, no_scan, Reason.OLD_SCAN, Reason.SCAN_AHEAD),
            ("pose", pose_age, self.limits.pose_age, Reason.NO_POSE, no_pose, Reason.OLD_POSE, Reason.POSE_AHEAD),
        ):
            if age is None:
                return none, missing
            if age > most + _ROUNDING:
                return old, f"the {what} is {age:.2f} s old"
            if age < -_AHEAD:
                return ahead, f"the {what} is {-age:.2f} s ahead of the clock"
        return None

    def _outside(self, place: np.ndarray | None) -> _Why | None:
        """Return how the position violates the fence; None if it does not."""
        if place is None:
            return None
        outside, side = distance_outside(place, self.limits)
        if outside > self.limits.margin:
            return Reason.OUTSIDE_FENCE, f"the vehicle is {outside:.1f} m outside the fence's {side}"
        return None


def _no_pose(place: np.ndarray | None, yaw: np.ndarray | None) -> _Why | None:
    """Return what is wrong with the numbers of a pose; None if nothing is."""
    if place is None or yaw is None:
        return Reason.NO_POSE, "a pose is a position of three numbers and a yaw"
    if not (np.isfinite(place).all() and np.isfinite(yaw).all()):
        return Reason.POSE_NOT_FINITE, f"the pose has numbers that are not finite: {place.tolist()}, yaw {yaw[0]}"
    return None


def _unfit(action: np.ndarray | None) -> _Why | None:
    """Return what is wrong with the action; None if nothing is."""
    if action is None:
        return Reason.NO_ACTION, "there is no action of four numbers"
    if not np.isfinite(action).all():
        return Reason.ACTION_NOT_FINITE, f"the action has numbers that are not finite: {action.tolist()}"
    return None


def _numbers(value: Any, count: int) -> np.ndarray | None:
    """Return a value as ``float64 [count]``; None if it is anything else."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return None
    if array.shape != (count,) or array.dtype.kind not in "fiu":
        return None
    with np.errstate(over="ignore"):
        return array.astype(np.float64)


def _age(now: float, stamp: Any) -> float | None:
    """Return the age of a stamp in s; None if the stamp is not a finite number."""
    number = _numbers([stamp], 1)
    return float(now - number[0]) if number is not None and math.isfinite(now - number[0]) else None
