"""What an autopilot has said of its vehicle: who flies it, and where it is. No socket, no clock, no pymavlink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from uavrl_onboard.autopilot.clock_sync import SenderClock
from uavrl_onboard.autopilot.firmware import FIRMWARES, MULTIROTORS, Firmware
from uavrl_onboard.autopilot.frames import Pose, Vector, swap_attitude, swap_world
from uavrl_onboard.autopilot.roster import Roster, Source
from uavrl_onboard.autopilot.signing import is_signed
from uavrl_onboard.enums import StrEnum

HEARTBEAT_TIMEOUT = 3.0  # s; heartbeats come once a second
_RESTART = 10_000  # ms by which an autopilot's clock goes back when it has restarted, and not for a late message
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_ASK_FOR_KEY = "give signing_key_file=, the file with the link's key. Nothing is sent"


class Control(StrEnum):
    """Who flies the vehicle."""

    WAITING = "waiting"  #: no autopilot has been heard yet
    UNSUPPORTED = "unsupported"  #: it is neither PX4 nor ArduPilot, or flies no multirotor
    AMBIGUOUS = "ambiguous"  #: several vehicles send, and nobody said which is ours
    SIGNED = "signed"  #: its link is signed, and we have no key
    LOST = "lost"  #: its heartbeats have ceased
    OTHER_MODE = "other_mode"  #: the pilot, or a mode of the autopilot
    DISARMED = "disarmed"  #: nobody, as the mode is for set-points and the motors are off
    IN_CONTROL = "in_control"  #: our set-points
    TAKEN_OVER = "taken_over"  #: the pilot or a failsafe, who took the mode for set-points away


@dataclass(frozen=True)
class VehicleStatus:
    """Who flies, and why we think so."""

    control: Control
    sentence: str
    firmware: str | None = None
    mode: str | None = None
    armed: bool = False


class _Latest:
    """The latest message of a kind; packets may come late or twice, and an autopilot may start anew."""

    def __init__(self, kind: str) -> None:
        self._clock = SenderClock(f"the autopilot's {kind}")
        self.stamp = 0.0
        self.fields: Any = None

    def hear(self, message: Any, now: float) -> None:
        stamp = self._clock.stamp(message.time_boot_ms / 1000.0, now)
        if stamp is not None:
            self.stamp, self.fields = stamp, message


class AutopilotMonitor:
    """Collects an autopilot's messages.

    Args:
        system: the MAVLink system id to listen to; by default that of the first vehicle heard.
        signs: whether we sign what we send.

    Attributes:
        roster: who was heard on the link.
        was_armed: whether it ever was armed in the mode for set-points.
        had_mode: whether it was ever seen in the mode for set-points.
        resets: how often its estimator has reset its pose, or the autopilot has restarted.
        refused: how many messages had no signature of our key.

    Examples:
        >>> vehicle = AutopilotMonitor()
        >>> vehicle.status(0.0).sentence
        'no autopilot has been heard yet'
    """

    def __init__(self, system: int | None = None, *, signs: bool = False) -> None:
        self.roster, self._signs = Roster(system), signs
        self.was_armed, self.had_mode, self.refused, self.resets = False, False, 0, 0
        self._beat: Any = None
        self._beat_at = 0.0
        self._position, self._attitude = _Latest("LOCAL_POSITION_NED"), _Latest("ATTITUDE")
        self._boot, self._rejoined, self._restarted = 0, False, False
        self._counters: dict[int, int] = {}  # of resets, by MAV_ESTIMATOR_TYPE

    @property
    def source(self) -> Source | None:
        """System and component id of the autopilot."""
        return self.roster.vehicle

    @property
    def firmware(self) -> Firmware | None:
        """The autopilot's dialect, where it is one of ours."""
        if self._beat is None or self._beat.type not in MULTIROTORS:
            return None
        return FIRMWARES.get(self._beat.autopilot)

    def hear(self, message: Any, now: float) -> bool:
        """Takes in one message that arrived at ``now``; whether it is our autopilot's."""
        kind = message.get_type()
        if kind == "HEARTBEAT":
            if not self.roster.admits(message, now):
                return False
            self._take_beat(message, now)
        elif (message.get_srcSystem(), message.get_srcComponent()) != self.source:
            return False
        elif kind in ("LOCAL_POSITION_NED", "ATTITUDE"):
            self._look_for_restart(message.time_boot_ms)
            (self._attitude if kind == "ATTITUDE" else self._position).hear(message, now)
        elif kind == "ODOMETRY":
            before = self._counters.get(message.estimator_type, message.reset_counter)
            self.resets += before != message.reset_counter
            self._counters[message.estimator_type] = message.reset_counter
        return True

    def _take_beat(self, beat: Any, now: float) -> None:
        if self._beat is not None and now - self._beat_at > HEARTBEAT_TIMEOUT:
            # Its clock may be another: what it sends now is not late.
            self._position, self._attitude, self._rejoined = _Latest("LOCAL_POSITION_NED"), _Latest("ATTITUDE"), True
        self._beat, self._beat_at = beat, now
        if (firmware := self.firmware) and firmware.mode_name(beat.custom_mode) == firmware.mode:
            self.had_mode, self._restarted = True, False
            self.was_armed = self.was_armed or bool(beat.base_mode & _ARMED)

    def _look_for_restart(self, boot: int) -> None:
        if boot < self._boot - (0 if self._rejoined else _RESTART):
            self.resets += 1
            self._restarted, self._boot = True, boot
        self._boot, self._rejoined = max(self._boot, boot), False

    def pose(self) -> Pose | None:
        """Where the vehicle was last, which may not be finite; ``None`` before position and attitude have come."""
        at, attitude = self._position.fields, self._attitude.fields
        if at is None or attitude is None:
            return None
        position: Vector = swap_world((at.x, at.y, at.z))
        stamp = min(self._position.stamp, self._attitude.stamp)
        roll, pitch, yaw = swap_attitude(attitude.roll, attitude.pitch, attitude.yaw)
        return Pose(stamp, position, swap_world((at.vx, at.vy, at.vz)), yaw, roll, pitch, self.resets)

    def status(self, now: float) -> VehicleStatus:
        """Who flies the vehicle at ``now``."""
        if self._beat is None:
            return VehicleStatus(Control.WAITING, self._unheard())
        firmware = self.firmware
        if firmware is None:
            kind = f"autopilot {self._beat.autopilot} of vehicle type {self._beat.type}"
            return VehicleStatus(
                Control.UNSUPPORTED, f"{kind} is no multirotor with PX4 or ArduPilot: nothing is sent to it"
            )
        mode, armed = firmware.mode_name(self._beat.custom_mode), bool(self._beat.base_mode & _ARMED)
        silent = now - self._beat_at
        if silent > HEARTBEAT_TIMEOUT:
            control, sentence = Control.LOST, f"no heartbeat for {silent:.1f} s"
        elif is_signed(self._beat) and not self._signs:
            control, sentence = Control.SIGNED, f"{firmware.name} signs its messages and ignores ours: {_ASK_FOR_KEY}"
        elif self.roster.is_ambiguous or (self.roster.rivals and not self.had_mode):
            control, sentence = Control.AMBIGUOUS, f"{self.roster.which()}. Nothing is sent"
        elif mode == firmware.mode and armed:
            control, sentence = Control.IN_CONTROL, f"{firmware.name} flies by set-points ({mode})"
        elif mode == firmware.mode:
            control, sentence = Control.DISARMED, f"{firmware.name} is in {mode}, and not armed"
        elif self.had_mode and self._restarted:
            again = f"give it {firmware.mode} again"
            control, sentence = Control.TAKEN_OVER, f"{firmware.name} has restarted and is in {mode}: {again}"
        elif self.had_mode:
            control, sentence = Control.TAKEN_OVER, f"{firmware.name} has left {firmware.mode} for {mode}"
        else:
            control, sentence = Control.OTHER_MODE, f"{firmware.name} is in {mode}, not in {firmware.mode}"
        return VehicleStatus(control, sentence, firmware.name, mode, armed)

    def _unheard(self) -> str:
        if self.refused:
            wrong = "it is another key, none, or the sender's clock is more than a minute behind ours"
            return f"no message bears a signature of signing_key_file=: {wrong} ({self.refused} were refused)"
        return self.roster.missing()
