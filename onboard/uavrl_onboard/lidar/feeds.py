"""A sensor on the network as a :class:`~uavrl_onboard.flight.interfaces.ScanFeed`."""

from __future__ import annotations

import time

from uavrl_onboard.lidar.packets import FLAG, PACKET_SIZE
from uavrl_onboard.lidar.scans import Scan, ScanAssembler
from uavrl_onboard.lidar.udp import NOTHING_CAME, UdpPackets

SILENCE = 1.0  # s without a packet of the sensor after which another one may take its place


class UdpScans:
    """The scans of one sensor that sends packets to this machine.

    The sensor is whoever sends the first data packet. What others send is left out and counted until it falls silent:
    two sensors on one port would make one scan of two places.

    Args:
        source: ``udp://:2368``.
        model: of the sensor, such as ``"VLP16"``.
        product: the product byte of a sensor whose packets carry another than its model's.

    Attributes:
        skipped: what was left out so far, by reason.

    Raises:
        UavrlError: for an unknown model, and where the port cannot be opened.
    """

    def __init__(self, source: str, model: str | None, product: int | None = None) -> None:
        self._assembler = ScanAssembler(model, product)
        self._packets = UdpPackets(source)
        self._sensor: tuple[str, float] | None = None  # its address, and when it was last heard
        self.skipped = self._assembler.skipped

    def poll(self, now: float) -> Scan | None:
        """The newest scan that has come since the last call; its stamp is of ``time.monotonic``."""
        newest = None
        for stamp, packet, sender in self._packets.waiting():
            if self._is_sensor(sender, packet, stamp):
                newest = self._assembler.push(stamp, packet) or newest
        return newest

    def _is_sensor(self, sender: str, packet: bytes, stamp: float) -> bool:
        is_data = len(packet) == PACKET_SIZE and packet[:2] == FLAG.to_bytes(2, "little")
        if is_data and (self._sensor is None or sender == self._sensor[0] or stamp - self._sensor[1] > SILENCE):
            self._sensor = (sender, stamp)
        if self._sensor is not None and sender != self._sensor[0]:
            self.skipped.other_sender += 1
            return False
        return True

    def trouble(self) -> str:
        """Why no scan came out, as a sentence's second half."""
        if self._sensor is not None and (silent := time.monotonic() - self._sensor[1]) > SILENCE:
            sender = self._sensor[0]
            return (
                f"no packet of {sender}, which had sent before, has come for {silent:.0f} s: look at sensor and cable."
            )
        return self._assembler.trouble() if self._assembler.heard else NOTHING_CAME

    def fileno(self) -> int:
        """For ``select``."""
        return self._packets.fileno()

    def close(self) -> None:
        """Closes the port."""
        self._packets.close()
