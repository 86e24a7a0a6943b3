"""The modes of PX4 or ArduPilot for a simulated vehicle, without a socket or a clock.

The rules for PX4 come from its documentation, with COM_OBL_RC_ACT set to 5 (hold). PX4 refuses Offboard until it has
received set-points for one second, and leaves Offboard one second after the last set-point. ArduPilot stays in GUIDED
and stops the vehicle after 3 s.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from types import ModuleType
from typing import Any, Literal, NamedTuple

from uavrl.errors import UavrlError
from uavrl.sitl.setpoints import Setpoint, read_setpoint
from uavrl_onboard.autopilot.firmware import FIRMWARES, Firmware
from uavrl_onboard.autopilot.mavlink import GAP, STREAM

_logger = logging.getLogger(__name__)

FirmwareName = Literal["px4", "ardupilot"]
ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)  # MAV_RESULT
OFFBOARD_LOSS = 1.0  # s without set-points after which PX4 leaves Offboard (COM_OF_LOSS_T)
GUIDED_TIMEOUT = 3.0  # s without set-points after which ArduPilot stops the vehicle (GUID_TIMEOUT)
_SLACK = 0.05  # s by which a second of set-points may be shorter at the receiver than at the sender
_FORCE = 21196.0  # second parameter of a command that disarms the vehicle even in the air
_SET_MODE, _ARM, _REQUEST, _INTERVAL, _VERSION_REQUEST = 176, 400, 512, 511, 520  # MAV_CMD
_WARNING, _INFO = 4, 6  # MAV_SEVERITY
AUTOPILOT_VERSION = 148


def _px4_custom_mode(main: float, within: float) -> int:
    return int(main) << 16 | int(within) << 24


class Dialect(NamedTuple):
    """The numbers of a firmware's modes."""

    autopilot: int  #: MAV_AUTOPILOT
    start: int  #: ``custom_mode`` at the start, in which the vehicle hovers
    ours: int  #: ``custom_mode`` in which the vehicle follows set-points
    pilot: int  #: ``custom_mode`` after the pilot has taken over
    custom_mode: Callable[[float, float], int]  #: makes it of the second and third parameter of MAV_CMD_DO_SET_MODE
    not_landed: int  #: MAV_RESULT that answers a command to disarm in the air

    @property
    def firmware(self) -> Firmware:
        """The firmware with its mode names."""
        return FIRMWARES[self.autopilot]


DIALECTS: dict[FirmwareName, Dialect] = {
    "px4": Dialect(12, 4 << 16 | 3 << 24, 6 << 16, 3 << 16, _px4_custom_mode, TEMPORARILY_REJECTED),
    "ardupilot": Dialect(3, 5, 4, 16, lambda mode, _: int(mode), FAILED),
}


class SimulatedAutopilot:
    """An autopilot whose vehicle is in the air: it changes its mode and answers commands.

    Args:
        messages: pymavlink's messages.
        firmware: the autopilot whose rules it follows.
        armed: whether it is armed at the start. A vehicle that is not armed hovers until it is.

    Attributes:
        mode: ``custom_mode`` of its heartbeat.
        armed: whether the motors run.
        answers: messages to send.
        changes: time in s, mode and reason of each change of the mode.
        set_interval: sets the interval of a message, for :class:`uavrl.sitl.telemetry.Telemetry`.
        request: requests a message, likewise.
        system: MAVLink system id.
    """

    def __init__(self, messages: ModuleType, firmware: FirmwareName = "px4", *, armed: bool = True) -> None:
        self._messages, self.dialect = messages, DIALECTS[firmware]
        self.mode, self.armed, self.system = self.dialect.start, armed, 1
        self.fell = False  #: True after it was disarmed in the air
        self.answers: list[Any] = []
        self.changes: list[tuple[float, str, str]] = [(0.0, self.mode_name, "start")]
        self.setpoints = 0  #: number of set-points that it has followed
        self.set_interval: Callable[[int, float], bool] = lambda number, interval: False
        self.request: Callable[[int], bool] = lambda number: False
        self._stream: tuple[float, float] | None = None  # times of the first and the latest set-point
        self._setpoint: Setpoint | None = None
        self._told = ""

    @property
    def mode_name(self) -> str:
        """The name of the mode."""
        return self.dialect.firmware.mode_name(self.mode)

    @property
    def in_control(self) -> bool:
        """True if the vehicle follows set-points."""
        return self.armed and self.mode == self.dialect.ours

    def hear(self, message: Any, now: float, yaw: float) -> None:
        """Handle a message that arrived at ``now``.

        Args:
            message: of MAVLink.
            now: time in s.
            yaw: of the vehicle in rad, counterclockwise from east.
        """
        kind = message.get_type()
        if kind == "BAD_DATA" or getattr(message, "target_system", 0) not in (0, self.system):
            return
        if getattr(message, "target_component", 0) not in (0, 1):
            return
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._take(message, now, yaw)
        elif kind in ("COMMAND_LONG", "COMMAND_INT"):
            parameters = [message.param1, message.param2, message.param3, message.param4]
            result = self._obey(message.command, [float(each) for each in parameters], now)
            sender = (message.get_srcSystem(), message.get_srcComponent())
            self.answers.append(self._messages.MAVLink_command_ack_message(message.command, result, 0, 0, *sender))
        elif kind == "SET_MODE":
            self._ask_for_mode(message.custom_mode, now)
        elif kind == "PING" and (message.target_system, message.target_component) == (0, 0):
            sender = (message.get_srcSystem(), message.get_srcComponent())
            self.answers.append(self._messages.MAVLink_ping_message(message.time_usec, message.seq, *sender))

    def tick(self, now: float) -> None:
        """Leave Offboard if no set-points have come for too long."""
        if self._is_px4 and self.mode == self.dialect.ours and self._age(now) > OFFBOARD_LOSS:
            self._change(self.dialect.start, now, f"no set-point for {OFFBOARD_LOSS:g} s")

    def take_over(self, now: float) -> None:
        """Change to the pilot's mode."""
        self._change(self.dialect.pilot, now, "the pilot took over")

    def setpoint(self, now: float) -> Setpoint | None:
        """Return the set-point that the vehicle follows; None if it hovers."""
        stale = not self._is_px4 and self._age(now) > GUIDED_TIMEOUT
        return self._setpoint if self.in_control and not stale else None

    @property
    def _is_px4(self) -> bool:
        return self.dialect is DIALECTS["px4"]

    def _age(self, now: float) -> float:
        """Return the age of the latest set-point in s."""
        return math.inf if self._stream is None else now - self._stream[1]

    def _streams(self, now: float) -> bool:
        """Return whether set-points have come for a second at more than 2 Hz."""
        if self._stream is None or self._age(now) > GAP:
            return False
        return now - self._stream[0] >= STREAM - _SLACK

    def _take(self, message: Any, now: float, yaw: float) -> None:
        try:
            setpoint = read_setpoint(message, yaw)
        except UavrlError as error:
            self._say(str(error), _WARNING)
            return
        begun, latest = self._stream or (now, now)
        self._stream = (begun if now - latest <= GAP else now, now)
        if self.in_control:
            self._setpoint = setpoint
            self.setpoints += 1

    def _obey(self, command: int, parameters: list[float], now: float) -> int:
        """Execute a command and return a MAV_RESULT."""
        whole = [each if math.isfinite(each) and abs(each) < 2**31 else 0.0 for each in parameters]
        if command == _SET_MODE:
            known = int(whole[0]) & 1 and 0 <= whole[1] < 256 and 0 <= whole[2] < 256
            return self._ask_for_mode(self.dialect.custom_mode(*whole[1:3]), now) if known else DENIED
        if command == _ARM:
            return self._ask_for_arming(whole[0] == 1.0, whole[1] == _FORCE)
        if command == _INTERVAL:
            return ACCEPTED if self.set_interval(int(whole[0]), whole[1]) else DENIED
        if command == _REQUEST:
            return ACCEPTED if self.request(int(whole[0])) else DENIED
        if command == _VERSION_REQUEST:
            return ACCEPTED if self.request(AUTOPILOT_VERSION) else DENIED
        return UNSUPPORTED

    def _ask_for_mode(self, mode: int, now: float) -> int:
        if mode not in (self.dialect.start, self.dialect.ours, self.dialect.pilot):
            name = self.dialect.firmware.mode_name(mode)
            self._say(f"{name} is a mode that the simulator does not fly", _WARNING)
            return DENIED
        if self._is_px4 and mode == self.dialect.ours and not self._streams(now):
            self._say("Offboard refused: set-points must come for 1 s", _WARNING)
            return TEMPORARILY_REJECTED
        if mode != self.mode:
            self._change(mode, now, "asked for")
        return ACCEPTED

    def _ask_for_arming(self, arm: bool, force: bool) -> int:
        if not arm and self.armed:
            if not force:
                self._say("Disarming refused: not landed", _WARNING)
                return self.dialect.not_landed
            self.fell = True
        self.armed = arm
        return ACCEPTED

    def _change(self, mode: int, now: float, reason: str) -> None:
        self.mode, self._setpoint = mode, None
        self.changes.append((round(now, 3), self.mode_name, reason))
        self._say(f"{self.mode_name}: {reason}", _INFO)

    def _say(self, text: str, severity: int) -> None:
        """Send and log a text, unless it was the last one."""
        if text != self._told:
            self._told = text
            _logger.info("Vehicle: %s", text)
            self.answers.append(self._messages.MAVLink_statustext_message(severity, text.encode()[:50]))
