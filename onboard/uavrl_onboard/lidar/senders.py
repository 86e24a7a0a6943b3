"""One sensor on a port or in a capture: two of them would make one scan of two places."""

from __future__ import annotations

from uavrl_onboard.lidar.scans import Assembler

SILENCE = 1.0  # s without a packet of the sensor after which another one may take its place
_NAMED = 3  # senders in a sentence


class OneSender:
    """Takes the packets of one sender and leaves out the others'.

    The sender is whoever sends the first data packet of the sensor. Once it falls silent, another one may take its
    place.

    Args:
        sensor: what knows the sensor's packets.

    Attributes:
        taken: address and port of the sender, None before its first data packet.
        heard: when it was last heard, s.
        others: address and port of the other senders.

    Examples:
        >>> from uavrl_onboard.lidar.packets import encode_scan
        >>> from uavrl_onboard.lidar.scans import ScanAssembler
        >>> from uavrl_onboard.lidar.vlp16 import firing_directions
        >>> senders, packet = OneSender(ScanAssembler("VLP16")), encode_scan(3.0 * firing_directions())[0]
        >>> senders.takes("192.168.1.201:2368", packet, 0.0), senders.takes("192.168.1.202:2368", packet, 0.001)
        (True, False)
        >>> senders.sentence()
        'Two senders: only 192.168.1.201:2368 is read, and the packets of 192.168.1.202:2368 are left out.'
    """

    def __init__(self, sensor: Assembler) -> None:
        self._sensor = sensor
        self.taken: str | None = None
        self.heard = 0.0
        self.others: dict[str, None] = {}  # in their order

    def takes(self, sender: str, packet: bytes, stamp: float) -> bool:
        """Return whether a packet is the sensor's, or no data packet: position packets come from another port.

        Args:
            sender: ``ADDRESS:PORT``.
            packet: what it sent.
            stamp: when it came, s.
        """
        is_data = self._sensor.is_data(packet)
        is_free = self.taken is None or sender == self.taken or stamp - self.heard > SILENCE
        if is_data and is_free and self._sensor.is_ours(packet):
            self.taken, self.heard = sender, stamp
        if not is_data or self.taken is None or sender == self.taken:
            return True
        self.others[sender] = None
        return False

    def sentence(self) -> str | None:
        """Say which senders there are, where there is more than one."""
        others = [sender for sender in self.others if sender != self.taken]
        if not others:
            return None
        how_many = "Two" if len(others) == 1 else str(len(others) + 1)
        packets = f"the packets of {', '.join(others[:_NAMED])} are left out"
        return f"{how_many} senders: only {self.taken} is read, and {packets}."
