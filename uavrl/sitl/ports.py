"""The ports of a simulated vehicle: MAVLink out and in."""

from __future__ import annotations

import logging
import select
import socket
from collections.abc import Iterable, Mapping
from types import ModuleType
from typing import Any

from uavrl.errors import UavrlError
from uavrl_onboard.autopilot.mavlink import PORT as AUTOPILOT_PORT
from uavrl_onboard.autopilot.signing import keep_time, read_key, start_signing
from uavrl_onboard.lidar.udp import address

_logger = logging.getLogger(__name__)

_AT_ONCE = 1000  # datagrams that one call reads at most
_CAMERA = 100  # MAV_COMP_ID_CAMERA


class SitlPorts:
    """Sends to an address from a port of its own, and hears what is sent to that port.

    Args:
        messages: pymavlink's messages.
        autopilot: where MAVLink goes, ``udp://HOST:PORT``.
        system: the vehicle's MAVLink system id.
        signing_key_file: file with the key of a signed link; None for one that is not signed.

    Raises:
        UavrlError: for what is no address, or a host that nobody knows.
    """

    def __init__(self, messages: ModuleType, autopilot: str, system: int, signing_key_file: str | None = None) -> None:
        self._mavlink_to = found(autopilot, AUTOPILOT_PORT)
        self._messages, self._writer = messages, messages.MAVLink(None, srcSystem=system, srcComponent=1)
        self._camera = messages.MAVLink(None, srcSystem=system, srcComponent=_CAMERA)
        self._signs = signing_key_file is not None
        if signing_key_file is not None:
            start_signing(self._writer, read_key(signing_key_file))
        self._autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        here = self._mavlink_to[0].startswith("127.")  # then nobody else is heard
        self._autopilot.bind(("127.0.0.1" if here else "", 0))
        self._autopilot.setblocking(False)
        self.number: int = self._autopilot.getsockname()[1]  #: of the autopilot's port

    def close(self) -> None:
        """Gives the port back."""
        self._autopilot.close()

    def send_beat_of_camera(self, fields: Mapping[str, int]) -> None:
        """Sends a heartbeat of a camera on the vehicle."""
        beat = self._messages.MAVLink_heartbeat_message(**fields)
        give(self._autopilot, beat.pack(self._camera), self._mavlink_to)

    def send_messages(self, messages: Iterable[Any]) -> None:
        """Sends what the autopilot sends."""
        if self._signs:
            keep_time(self._writer)
        for message in messages:
            give(self._autopilot, message.pack(self._writer), self._mavlink_to)

    def wait(self, seconds: float) -> bool:
        """Waits until something has come; False where nothing has in so many seconds."""
        return bool(select.select([self._autopilot], [], [], max(seconds, 0.0))[0])

    def heard(self) -> list[Any]:
        """All messages that have come; nothing waits in it."""
        found: list[Any] = []
        for _ in range(_AT_ONCE):
            try:
                data = self._autopilot.recv(65535)
            except OSError:
                break
            parser = self._messages.MAVLink(None)
            parser.robust_parsing = True  # bytes that are no message come out as such, not as an exception
            parser.signing = self._writer.signing  # of a signed link, what bears no signature is none
            found += parser.parse_buffer(data) or []
        return found


def give(sender: socket.socket, packet: Any, to: tuple[str, int]) -> None:
    """Sends a packet, if it can be sent."""
    try:
        sender.sendto(packet, to)
    except OSError as error:  # nobody listens, or the network is down
        _logger.debug("A packet was not sent: %s", error)


def found(where: str, port: int) -> tuple[str, int]:
    """The numbers of an address, found once and not for each packet."""
    host, number = address(where, port)
    try:
        return socket.gethostbyname(host or "127.0.0.1"), number
    except OSError as error:
        raise UavrlError(f"{where} cannot be sent to ({error.strerror}): give a host of this network.") from error
