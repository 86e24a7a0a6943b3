"""Packets as they arrive by UDP."""

from __future__ import annotations

import re
import select
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import closing

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.packets import PORT

NOTHING_CAME = "no packet arrived. Set this computer's address and the port as the host on the sensor's own web page."
_ADDRESS = re.compile(r"udp://(?P<host>[^:/]*)(?::(?P<port>\d{1,5}))?/?")
_BUFFER = 2**23  # bytes that the system keeps for us, if it may: some turns of any sensor, in case we are late
_LONGEST = 2**16  # bytes of a packet that are read, which is any
_AT_ONCE = 1000  # packets that are read at once
_TICK = 0.05  # s between two looks at the clock while nothing arrives
_ARRIVAL = 35 if sys.platform == "linux" else None  # SO_TIMESTAMPNS: the system says when a packet arrived
_TIMESPEC = "qq"  # seconds and nanoseconds of the system's clock


def address(source: str, port: int = PORT) -> tuple[str, int]:
    """Host and port of ``udp://HOST:PORT``; either may be left out.

    Examples:
        >>> address("udp://:2368"), address("udp://192.168.1.100")
        (('', 2368), ('192.168.1.100', 2368))
    """
    match = _ADDRESS.fullmatch(source)
    number = int(match["port"] or port) if match else 0
    if match is None or not 0 < number < 2**16:
        raise UavrlError(f"An address is udp://:PORT or udp://HOST:PORT, such as udp://:{port}, got {source!r}.")
    return match["host"], number


def listen(source: str, port: int = PORT) -> socket.socket:
    """A socket that receives what is sent to ``udp://HOST:PORT`` on this machine.

    Raises:
        UavrlError: where the port cannot be opened.
    """
    where = address(source, port)
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    try:
        opened.bind(where)
    except OSError as error:
        opened.close()
        raise UavrlError(
            f"{source} cannot be listened to ({error.strerror}): another program may have the port, or the address is "
            "none of this machine's."
        ) from error
    return opened


class UdpPackets:
    """The packets that are sent to a port of this machine, with their times of arrival. Nothing waits in it.

    Times are in seconds of ``time.monotonic``, as the safety layer's are. On Linux a packet that waited because we were
    busy has the time at which it arrived, elsewhere that at which it was read.

    Args:
        source: ``udp://:2368`` listens on all of this machine's addresses; ``udp://HOST:2368`` on one of them.
        port: where the source names none.

    Raises:
        UavrlError: where the port cannot be opened.
    """

    def __init__(self, source: str, port: int = PORT) -> None:
        self._socket = listen(source, port)
        self._socket.setblocking(False)
        if _ARRIVAL is not None:
            self._socket.setsockopt(socket.SOL_SOCKET, _ARRIVAL, 1)

    def fileno(self) -> int:
        """For ``select``."""
        return self._socket.fileno()

    def close(self) -> None:
        """Closes the port."""
        self._socket.close()

    def waiting(self) -> Iterator[tuple[float, bytes, str]]:
        """Time, content and sender (``ADDRESS:PORT``) of each packet that has come, at most a thousand at once."""
        for _ in range(_AT_ONCE):
            try:
                packet, said, _, sender = self._socket.recvmsg(_LONGEST, socket.CMSG_SPACE(struct.calcsize(_TIMESPEC)))
            except OSError:  # nothing waits
                return
            yield time.monotonic() - _waited(said), packet, f"{sender[0]}:{sender[1]}"


def read_udp(
    source: str, seconds: float | None = None, silence: float = 5.0, port: int = PORT
) -> Iterator[tuple[float, bytes, str]]:
    """The time of arrival, the content and the sender of each packet of ``UdpPackets``.

    Args:
        source: where to listen.
        seconds: how long to listen in all; None for as long as packets come.
        silence: after how many seconds without a packet it ends.
        port: where the source names none.

    Raises:
        UavrlError: where the port cannot be opened.
    """
    with closing(UdpPackets(source, port)) as packets:
        begun = heard = time.monotonic()
        while time.monotonic() - heard < silence and (seconds is None or time.monotonic() - begun < seconds):
            if select.select([packets], [], [], _TICK)[0]:
                heard = time.monotonic()
                yield from packets.waiting()


def _waited(said: list[tuple[int, int, bytes]]) -> float:
    """How long ago a packet arrived, in s; 0 where the system does not say."""
    for _, kind, content in said:
        if kind == _ARRIVAL and len(content) == struct.calcsize(_TIMESPEC):
            seconds, nanoseconds = struct.unpack(_TIMESPEC, content)
            return float(max(time.time() - seconds - 1e-9 * nanoseconds, 0.0))
    return 0.0
