"""Set-points to an autopilot and its state from it, as MAVLink over UDP: PX4 in Offboard, ArduPilot in GUIDED."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any

import numpy as np

from uavrl_onboard.autopilot.frames import Pose, to_command
from uavrl_onboard.autopilot.signing import INVALID, keep_time, read_key, start_signing
from uavrl_onboard.autopilot.vehicle_state import AutopilotMonitor, Control, VehicleStatus
from uavrl_onboard.libraries import needed
from uavrl_onboard.lidar.udp import listen

_logger = logging.getLogger(__name__)

PORT = 14540  # where PX4 sends what is meant for a companion computer
ADDRESS = f"udp://:{PORT}"
TYPE_MASK = 1479  # of SET_POSITION_TARGET_LOCAL_NED: ignore position, acceleration and yaw; take velocity and yaw rate
BODY_NED = 8  # MAV_FRAME_BODY_NED, which autopilots turn with the yaw alone
COMPONENT = 191  # ours, in the vehicle's system: MAV_COMP_ID_ONBOARD_COMPUTER
STREAM = 1.0  # s of set-points before Offboard is asked for
GAP = 0.5  # s between two set-points after which a stream has ended
_EVERY = 1.0  # s between two heartbeats, and between two requests of a kind
_TRIES = 5  # requests for the mode or for arming
_INTERVAL = 20_000.0  # µs between two positions, and between two attitudes
_OLD_POSE = 0.1  # s
_AT_ONCE = 1000  # packets that one call reads at most
_POSE_MESSAGES = (30, 32)  # ATTITUDE, LOCAL_POSITION_NED
_BEGINNINGS = (b"\xfd", b"\xfe")  # of a message of MAVLink 2 and 1
_ACCEPTED = 0  # MAV_RESULT
_ANYBODY = (Control.WAITING, Control.LOST, Control.UNSUPPORTED)  # then the vehicle may send from anywhere
_UNSENT = (Control.AMBIGUOUS, Control.SIGNED)
_CUSTOM_MODE = 1.0  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


def mavlink() -> ModuleType:
    """The messages of pymavlink that PX4 and ArduPilot have in common."""
    common: ModuleType = needed("pymavlink.dialects.v20.common", "The link to an autopilot", "mavlink")
    return common


class Autopilot:
    """The link to an autopilot, which sends to our port and is answered where it sends from.

    It arms nothing and changes no mode unless it is told to, and then asks for the mode only after set-points have
    flowed for a second, and never again once the pilot or a failsafe has taken it away.

    Args:
        source: where to listen, ``udp://:14540``.
        set_mode: ask for Offboard or GUIDED.
        arm: ask for arming, once the mode is ours.
        system: the MAVLink system id of the vehicle; by default that of the first vehicle heard.
        signing_key_file: the file with the link's signing key; None: messages are neither signed nor verified.

    Raises:
        UavrlError: where pymavlink is missing, the key cannot be read, or the port cannot be opened.
    """

    def __init__(
        self,
        source: str = ADDRESS,
        *,
        set_mode: bool = False,
        arm: bool = False,
        system: int | None = None,
        signing_key_file: str | None = None,
    ) -> None:
        self._messages = mavlink()
        key = None if signing_key_file is None else read_key(signing_key_file)
        self._socket = listen(source, PORT)
        self._socket.setblocking(False)
        self._writer = self._messages.MAVLink(self, srcComponent=COMPONENT)
        if key is not None:
            start_signing(self._writer, key)
        self._parser, self._sender = self._new_parser(), ("", 0)
        self._peer: tuple[str, int] | None = None
        self._told = set[str]()
        self.vehicle = AutopilotMonitor(system, signs=key is not None)
        self._wants = {"mode": set_mode, "arm": arm}
        self._tries = {"mode": 0, "arm": 0}
        self._answer = ""
        self._due = dict.fromkeys(("heartbeat", "pose", "mode", "arm"), float("-inf"))
        self._stream: tuple[float, float] | None = None  # of its first and its latest set-point

    def __enter__(self) -> Autopilot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the port. Nothing is sent: the autopilot's failsafe acts where set-points cease."""
        self._socket.close()

    def fileno(self) -> int:
        """For ``select``: a loop that reads what has come at once knows its age best."""
        return self._socket.fileno()

    def receive(self, now: float) -> None:
        """Reads all that has come; call it more often than set-points are sent, as what it reads is stamped ``now``."""
        for _ in range(_AT_ONCE):
            try:
                data, sender = self._socket.recvfrom(65535)
            except OSError:  # nothing waits; or an earlier packet of ours was refused
                return
            status = self.status(now)
            if self._peer not in (None, sender) and status.control not in _ANYBODY:
                self._note_stranger(data, sender, now)
                continue
            for message in self._parsed(data, sender):
                if message.get_type() == "BAD_DATA":
                    self.vehicle.refused += message.reason == INVALID
                elif self.vehicle.hear(message, now):
                    self._peer = sender
                    self._acknowledged(message)
            if self.vehicle.roster.rivals:
                self._tell(f"{self.vehicle.roster.which()}.")

    def send(self, setpoint: Sequence[float] | np.ndarray | None, now: float) -> None:
        """Sends a set-point (l_x, l_y, l_z, a_z), or none, and what else is due: call it ten times a second.

        Raises:
            UavrlError: for a set-point that is not four finite numbers.
        """
        command = None if setpoint is None else to_command(setpoint)
        if self.vehicle.source is None or self.vehicle.firmware is None or self.status(now).control in _UNSENT:
            return
        self._writer.srcSystem = self.vehicle.source[0]
        if command is None:
            self._stream = None
        else:
            forward, right, down, yaw_rate = command
            velocity, ignored = (forward, right, down), (0.0, 0.0, 0.0)
            boot_ms, target = int(now * 1000.0) % 2**32, self.vehicle.source
            self._writer.set_position_target_local_ned_send(
                boot_ms, *target, BODY_NED, TYPE_MASK, *ignored, *velocity, *ignored, 0.0, yaw_rate
            )
            begun, latest = self._stream or (now, now)
            self._stream = (begun if now - latest <= GAP else now, now)
        if self._is_due("heartbeat", now):
            keep_time(self._writer)
            onboard, no_autopilot, active = 18, 8, 4  # MAV_TYPE, MAV_AUTOPILOT, MAV_STATE
            self._writer.heartbeat_send(onboard, no_autopilot, 0, 0, active)
        pose = self.vehicle.pose()
        if (pose is None or now - pose.stamp > _OLD_POSE) and self._is_due("pose", now):
            for message in _POSE_MESSAGES:
                self._request(self._messages.MAV_CMD_SET_MESSAGE_INTERVAL, message, _INTERVAL)
        self._ask(now)

    def pose(self) -> Pose | None:
        """Where the vehicle is, in the world's axes (`uavrl_onboard.autopilot.frames`)."""
        return self.vehicle.pose()

    def status(self, now: float) -> VehicleStatus:
        """Who flies the vehicle."""
        return self.vehicle.status(now)

    @property
    def signs(self) -> bool:
        """Whether what is sent bears a signature."""
        return bool(self._writer.signing.sign_outgoing)

    @property
    def answer(self) -> str:
        """What the autopilot last answered to a request for its mode or for arming."""
        return self._answer

    def write(self, packet: bytes) -> None:
        """Sends one packet to where the autopilot sends from; pymavlink calls it."""
        if self._peer is not None:
            try:
                self._socket.sendto(packet, self._peer)
            except OSError as error:  # the network is down: the autopilot's silence tells
                _logger.debug("A packet was not sent: %s", error)

    def _is_due(self, kind: str, now: float) -> bool:
        """Whether it is time for something that is sent once a second."""
        due = now >= self._due[kind]
        if due:
            self._due[kind] = now + _EVERY
        return due

    def _request(self, command: int, *parameters: float) -> None:
        assert self.vehicle.source is not None
        missing = [0.0] * (7 - len(parameters))
        self._writer.command_long_send(*self.vehicle.source, command, 0, *parameters, *missing)

    def _ask(self, now: float) -> None:
        """Asks for the mode or for arming, where we are told to and may."""
        control, firmware = self.vehicle.status(now).control, self.vehicle.firmware
        streams = self._stream is not None and self._stream[1] - self._stream[0] >= STREAM
        if firmware is None or not streams:
            return
        if control is Control.OTHER_MODE and self._may_ask("mode", now):
            self._request(self._messages.MAV_CMD_DO_SET_MODE, _CUSTOM_MODE, *firmware.request)
        if control is Control.DISARMED and not self.vehicle.was_armed and self._may_ask("arm", now):
            self._request(self._messages.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def _may_ask(self, kind: str, now: float) -> bool:
        if not self._wants[kind] or self._tries[kind] >= _TRIES or not self._is_due(kind, now):
            return False
        self._tries[kind] += 1
        _logger.info("Autopilot: asked for %s, %d of at most %d times", kind, self._tries[kind], _TRIES)
        return True

    def _acknowledged(self, message: Any) -> None:
        if message.get_type() == "COMMAND_ACK":
            results, commands = (self._messages.enums[name] for name in ("MAV_RESULT", "MAV_CMD"))
            command, result = commands.get(message.command), results.get(message.result)
            if message.command in (self._messages.MAV_CMD_DO_SET_MODE, self._messages.MAV_CMD_COMPONENT_ARM_DISARM):
                self._answer = f"{command.name}: {result.name if result else message.result}"
                _logger.info("Autopilot: %s", self._answer)
            asked = self._tries["mode"] > 0 and message.target_component in (0, COMPONENT)
            if asked and (message.command, message.result) == (self._messages.MAV_CMD_DO_SET_MODE, _ACCEPTED):
                self._wants["mode"] = False  # who takes it away before the next heartbeat shall keep it, too

    def _new_parser(self) -> Any:
        parser = self._messages.MAVLink(None)
        parser.robust_parsing = True  # bytes that are no message come out as such, not as an exception
        parser.signing = self._writer.signing  # one key and one time for both directions
        return parser

    def _note_stranger(self, data: bytes, sender: tuple[str, int], now: float) -> None:
        """Look whether another address speaks for a vehicle, too: it is not obeyed, and the user is told."""
        if data[:1] not in _BEGINNINGS:
            return
        for message in self._new_parser().parse_buffer(data) or []:
            if message.get_type() != "HEARTBEAT":
                continue
            self.vehicle.roster.note(message, now)
            if (message.get_srcSystem(), message.get_srcComponent()) == self.vehicle.source and self._peer is not None:
                ours, other = (f"{host}:{port}" for host, port in (self._peer, sender))
                self._tell(f"{other} sends as system {message.get_srcSystem()} as well: only {ours} is listened to.")

    def _tell(self, sentence: str) -> None:
        """Log a warning once."""
        if sentence not in self._told:
            self._told.add(sentence)
            _logger.warning("Vehicle: %s", sentence)

    def _parsed(self, data: bytes, sender: tuple[str, int]) -> Iterator[Any]:
        """The messages in what one sender sent; a message may begin in one packet and end in the next.

        What begins like a message is one: so noise, or half a message, spoils nothing that comes after it.
        """
        if sender != self._sender or data[:1] in _BEGINNINGS:
            self._parser, self._sender = self._new_parser(), sender
        yield from self._parser.parse_buffer(data) or []
        # pymavlink frees its buffer only when it has read all of it.
        self._parser.buf = self._parser.buf[self._parser.buf_index :]
        self._parser.buf_index = 0
