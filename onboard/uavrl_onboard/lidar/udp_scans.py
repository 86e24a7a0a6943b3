"""A sensor on the network as a :class:`~uavrl_onboard.flight.interfaces.ScanFeed`."""

from __future__ import annotations

import time

from uavrl_onboard.lidar.assemblers import make_assembler
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.lidar.senders import SILENCE, OneSender
from uavrl_onboard.lidar.udp import NOTHING_CAME, UdpPackets


class UdpScans:
    """The scans of one sensor that sends packets to this machine.

    The sensor is whoever sends the first data packet of the model. What others send is left out and counted until it
    falls silent: two sensors on one port would make one scan of two places.

    Args:
        source: ``udp://:2368``.
        model: of a Velodyne, such as ``"VLP16"``.
        product: the product byte of a sensor whose packets carry another than its model's.
        metadata: file with the metadata of an Ouster, instead of a model.

    Attributes:
        skipped: what was left out so far, by reason.

    Raises:
        UavrlError: for an unknown model, metadata that cannot be read, and where the port cannot be opened.
    """

    def __init__(self, source: str, model: str | None, product: int | None = None, metadata: str | None = None) -> None:
        self._assembler = make_assembler(model, product, metadata)
        self._packets = UdpPackets(source, self._assembler.port)
        self._senders = OneSender(self._assembler)
        self.skipped = self._assembler.skipped

    def poll(self, now: float) -> Scan | None:
        """The newest scan that has come since the last call; its stamp is of ``time.monotonic``."""
        newest = None
        for stamp, packet, sender in self._packets.waiting():
            if self._senders.takes(sender, packet, stamp):
                newest = self._assembler.push(stamp, packet) or newest
            else:
                self.skipped.other_sender += 1
        return newest

    def remarks(self) -> list[str]:
        """What the user should know of the port, though scans come."""
        return [sentence] if (sentence := self._senders.sentence()) else []

    def trouble(self) -> str:
        """Why no scan came out, as a sentence's second half."""
        sender = self._senders.taken
        if sender is not None and (silent := time.monotonic() - self._senders.heard) > SILENCE:
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
