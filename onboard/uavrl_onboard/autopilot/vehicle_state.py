"""What an autopilot has said of its vehicle: who flies it, and where it is. No socket, no clock, no pymavlink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from uavrl_onboard.autopilot.clock_sync import SenderClock
from uavrl_onboard.autopilot.firmware import FIRMWARES, MULTIROTORS, Firmware
from uavrl_onboard.autopilot.frames import Pose, Vector, swap_attitude, swap_world
from uavrl_onboard.enums import StrEnum

HEARTBEAT_TIMEOUT = 3.0  # s; heartbeats come once a second
_NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID: a ground station, a camera, a companion
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED


class Control(StrEnum):
    """Who flies the vehicle."""

    WAITING = "waiting"  #: no autopilot has been heard yet
    UNSUPPORTED = "unsupported"  #: it is neither PX4 nor ArduPilot, or flies no multirotor
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

    def __init__(self) -> None:
        self._clock = SenderClock()
        self.stamp = 0.0
        self.fields: Any = None

    def hear(self, message: Any, now: float) -> None:
        stamp = self._clock.stamp(message.time_boot_ms / 1000.0, now)
        if stamp is not None:
            self.stamp, self.fields = stamp, message


class Vehicle:
    """Collects an autopilot's messages.

    Args:
        system: the MAVLink system id to listen to; by default the first autopilot heard.

    Examples:
        >>> vehicle = Vehicle()
        >>> vehicle.status(0.0).sentence
        'no autopilot has been heard yet'
    """

    def __init__(self, system: int | None = None) -> None:
        self._only = system
        self.source: tuple[int, int] | None = None  #: system and component id of the autopilot
        self.was_armed = False  #: whether it ever was in the mode for set-points
        self.had_mode = False  #: whether it was ever seen in the mode for set-points
        self._beat: Any = None
        self._beat_at = 0.0
        self._position, self._attitude = _Latest(), _Latest()

    @property
    def firmware(self) -> Firmware | None:
        """The autopilot's dialect, where it is one of ours."""
        if self._beat is None or self._beat.type not in MULTIROTORS:
            return None
        return FIRMWARES.get(self._beat.autopilot)

    def hear(self, message: Any, now: float) -> bool:
        """Takes in one message that arrived at ``now``; whether it is our autopilot's."""
        kind, source = message.get_type(), (message.get_srcSystem(), message.get_srcComponent())
        if kind == "HEARTBEAT" and message.autopilot != _NO_AUTOPILOT and self._may_be_ours(source, now):
            self.source, self._beat, self._beat_at = source, message, now
            if (firmware := self.firmware) and firmware.mode_name(message.custom_mode) == firmware.mode:
                self.had_mode = True
                self.was_armed = self.was_armed or bool(message.base_mode & _ARMED)
        elif source != self.source:
            return False
        elif kind == "LOCAL_POSITION_NED":
            self._position.hear(message, now)
        elif kind == "ATTITUDE":
            self._attitude.hear(message, now)
        return source == self.source

    def pose(self) -> Pose | None:
        """Where the vehicle was last, which may not be finite; ``None`` before position and attitude have come."""
        at, attitude = self._position.fields, self._attitude.fields
        if at is None or attitude is None:
            return None
        position: Vector = swap_world((at.x, at.y, at.z))
        stamp = min(self._position.stamp, self._attitude.stamp)
        roll, pitch, yaw = swap_attitude(attitude.roll, attitude.pitch, attitude.yaw)
        return Pose(stamp, position, swap_world((at.vx, at.vy, at.vz)), yaw, roll, pitch)

    def status(self, now: float) -> VehicleStatus:
        """Who flies the vehicle at ``now``."""
        if self._beat is None:
            return VehicleStatus(Control.WAITING, "no autopilot has been heard yet")
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
        elif mode == firmware.mode and armed:
            control, sentence = Control.IN_CONTROL, f"{firmware.name} flies by set-points ({mode})"
        elif mode == firmware.mode:
            control, sentence = Control.DISARMED, f"{firmware.name} is in {mode}, and not armed"
        elif self.had_mode:
            control, sentence = Control.TAKEN_OVER, f"{firmware.name} has left {firmware.mode} for {mode}"
        else:
            control, sentence = Control.OTHER_MODE, f"{firmware.name} is in {mode}, not in {firmware.mode}"
        return VehicleStatus(control, sentence, firmware.name, mode, armed)

    def _may_be_ours(self, source: tuple[int, int], now: float) -> bool:
        """Whether an autopilot's heartbeat is of the one that we listen to; another may follow one that is lost."""
        if self._only is not None:
            return source[0] == self._only
        return self.source in (None, source) or now - self._beat_at > HEARTBEAT_TIMEOUT
