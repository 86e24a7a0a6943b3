"""From packets to scans: what belongs to a turn of the sensor, what is left out, and why."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import NEAREST_RETURN
from uavrl_onboard.libraries import needed
from uavrl_onboard.lidar.packets import (
    DUAL,
    FLAG,
    FULL_TURN,
    HOUR,
    LAST,
    PACKET,
    PACKET_SIZE,
    PACKET_TIMES,
    PORT,
    POSITION_SIZE,
    PRODUCTS,
    STRONGEST,
    decode_vlp16,
)
from uavrl_onboard.pluralize import pluralize

LONGEST_TURN = 300_000  # microseconds: the slowest sensor takes 200,000
WIDEST_GAP = 3_000  # hundredths of a degree, two columns of the range image: a policy takes what is not seen for free
MOST_PACKETS = 4096  # of a scan, whatever the clock in the packets says


@dataclass(frozen=True)
class Scan:
    """One turn of the sensor, which can be unpacked as ``stamp, points``."""

    #: Time of its last packet in s. By UDP it is that of its arrival on the clock of ``time.monotonic``, as the safety
    #: layer has it; of a recording by the recorder's clock, or the sensor's where it has no other.
    stamp: float
    points: np.ndarray  #: ``float32 [P, 3]`` in m in the sensor frame: x forward, y left, z up
    rays: int  #: How many rays it is made of
    misses: int  #: How many of them hit nothing
    packets: int = 0  #: How many packets it is made of; 0 for a message

    def __iter__(self) -> Iterator[Any]:
        """Gives the stamp and the points."""
        yield self.stamp
        yield self.points


@dataclass
class Skipped:
    """How much of a source was left out, by reason."""

    other_size: int = field(default=0, metadata={"of": "packet", "says": "of another size than a data packet's"})
    other_product: int = field(default=0, metadata={"of": "packet", "says": "of another model"})
    other_serial: int = field(default=0, metadata={"of": "packet", "says": "of a sensor with another serial number"})
    damaged: int = field(default=0, metadata={"of": "packet", "says": "of a data packet's size without its data"})
    dual: int = field(default=0, metadata={"of": "packet", "says": "with two returns per ray"})
    lost: int = field(default=0, metadata={"of": "packet", "says": "that never arrived"})
    late: int = field(default=0, metadata={"of": "packet", "says": "out of order"})
    late_messages: int = field(default=0, metadata={"of": "message", "says": "no newer than the one before"})
    other_frame: int = field(default=0, metadata={"of": "message", "says": "in another frame than the sensor's"})
    incomplete: int = field(default=0, metadata={"of": "turn", "says": "with a gap or without an end"})
    malformed: int = field(default=0, metadata={"of": "message", "says": "that could not be read"})
    other_sender: int = field(default=0, metadata={"of": "packet", "says": "of a second sender"})
    position: int = field(default=0, metadata={"of": "position packet", "says": "without points"})
    imu: int = field(default=0, metadata={"of": "IMU packet", "says": "without points"})

    def sentences(self) -> list[str]:
        """One line for each reason that occurred."""
        about = {name: kind.metadata for name, kind in self.__dataclass_fields__.items()}
        counts = [(count, about[name]) for name, count in asdict(self).items() if count]
        return [f"{pluralize(count, of['of'])} {of['says']}" for count, of in counts]


BESIDE_SCANS = ("position", "imu")
"""What `Skipped` counts though nothing is missing: sensors send it beside their scans."""


class Assembler(Protocol):
    """Makes scans of the packets of one sensor."""

    skipped: Skipped  #: what was left out so far
    heard: bool  #: whether there was any packet
    port: int  #: of UDP to which the sensor sends

    def is_data(self, packet: bytes) -> bool:
        """Whether a packet carries returns, of this sensor or of one like it."""

    def is_ours(self, packet: bytes) -> bool:
        """Whether a packet with returns is of this sensor, as far as it says."""

    def push(self, stamp: float, packet: bytes) -> Scan | None:
        """Take a packet that arrived at ``stamp`` seconds; return the scan that it closes, if it closes one."""

    def finish(self, stamp: float) -> Scan | None:
        """Return the open turn, when no packet comes any more, if it is nearly whole."""

    def trouble(self) -> str:
        """Why no scan came out, as a sentence's second half."""


def check_model(model: str | None) -> str:
    """Returns the model, or says which there are: it is never guessed from the data."""
    if model not in PRODUCTS:
        raise UavrlError(
            f"model must be one of {', '.join(PRODUCTS)}, got {model!r}: name the sensor that sent the packets, which "
            "is not guessed, or give metadata=FILE for an Ouster."
        )
    return model


class Decoder(NamedTuple):
    """What makes points ``float32 [P, 3]`` of the packets of a turn, in two steps.

    A packet is unpacked when it arrives, so that little is left to do when the turn ends.
    """

    unpack: Callable[[bytes], Any]
    points: Callable[[list[Any]], np.ndarray]

    def __call__(self, packets: Iterable[bytes]) -> np.ndarray:
        """Do both."""
        return self.points([self.unpack(packet) for packet in packets])


def make_decoder(model: str) -> Decoder:
    """Return the decoder of `velodyne-decoder`, or ours where that is not installed and the model is a VLP-16."""
    try:
        velodyne = needed("velodyne_decoder", f"Decoding the packets of a {model}", "lidar")
    except UavrlError:
        if model == "VLP16":
            return Decoder(bytes, decode_vlp16)
        raise
    kind = velodyne.Model[model]
    # The bundled calibration of a VLP-16 lets all beams leave one point, as in the simulator.
    calibration = velodyne.get_bundled_calibration("VLP-16.yml") if model == "VLP16" else None
    decoder = velodyne.ScanDecoder(
        velodyne.Config(model=kind, calibration=calibration, min_range=NEAREST_RETURN, max_range=1000.0)
    )

    def points(packets: list[Any]) -> np.ndarray:
        found = decoder.decode(velodyne.PacketVector(packets))[1]
        return np.ascontiguousarray(found[:, :3].T, dtype=np.float32).T  # coordinate by coordinate, as they are read

    return Decoder(partial(velodyne.VelodynePacket, 0.0), points)


class ScanAssembler:
    """Joins packets, one at a time, to scans of a full turn each.

    A scan ends with the packet that closes the turn, wherever it began. What is no data packet of the model is counted
    and left out, as is a turn that takes longer than 0.3 s or has a gap of more than 30 degrees. A packet that comes
    late still belongs to its scan if that has not ended; one that comes twice counts once.

    Args:
        model: of the sensor; one of `uavrl_onboard.lidar.packets.PRODUCTS`.
        product: the product byte of a sensor whose packets carry another than the model's.

    Attributes:
        skipped: what was left out so far.
        products: the product bytes that were refused.
        heard: whether there was any packet.
        port: UDP port to which the sensor sends unless it is told another.

    Examples:
        >>> from uavrl_onboard.lidar.packets import encode_scan
        >>> from uavrl_onboard.lidar.vlp16 import firing_directions
        >>> assembler = ScanAssembler("VLP16")
        >>> scans = [assembler.push(0.0, packet) for packet in encode_scan(3.0 * firing_directions())]
        >>> [scan.points.shape for scan in scans if scan], scans[-1].rays
        ([(28928, 3)], 29184)
    """

    def __init__(self, model: str | None, product: int | None = None) -> None:
        self.model = check_model(model)
        self.product = PRODUCTS[self.model] if product is None else product
        self._own = bytes([PRODUCTS[self.model]])  # the product byte that the decoder expects
        self.skipped, self.port = Skipped(), PORT
        self.products = set[int]()
        self.heard = False
        self._decode = make_decoder(self.model)
        self._single = self._decode.points is decode_vlp16
        self._newest: int | None = None  # the latest packet's time in microseconds
        self._azimuth = 0  # of its last block
        # Of the open turn, each as it came and unpacked, behind its age since the turn's first one.
        self._packets: list[tuple[int, bytes, Any]] = []
        self._covered, self._advance, self._begun = 0, 0, 0  # angles of the open turn and of its last packet, a time

    def is_data(self, packet: bytes) -> bool:
        """Whether a packet is a data packet of any model."""
        return len(packet) == PACKET_SIZE and packet[:2] == FLAG.to_bytes(2, "little")

    def is_ours(self, packet: bytes) -> bool:
        """Whether a data packet carries the product byte that is expected."""
        return packet[-1] == self.product

    def push(self, stamp: float, packet: bytes) -> Scan | None:
        """Takes a packet that arrived at ``stamp`` seconds; returns the scan that it closes, if it closes one."""
        self.heard, read = True, self._checked(packet)
        if read is None:
            return None
        time, first, last = int(read["time"]), int(read["blocks"]["azimuth"][0]), int(read["blocks"]["azimuth"][-1])
        after = 0 if self._newest is None else (time - self._newest + HOUR // 2) % HOUR - HOUR // 2
        if self._newest is None or abs(after) > LONGEST_TURN:
            self._abandon()
        elif after < 0:
            self._take_late(time, packet)
            return None
        elif after > 0:
            period = PACKET_TIMES[self.model] / (2 if int(read["mode"]) == DUAL else 1)
            self.skipped.lost += max(round(after / period) - 1, 0)
        if not self._packets:
            self._begun, self._covered, self._azimuth = time, 0, first
        self._advance = (last - self._azimuth) % FULL_TURN
        self._covered += self._advance
        self._newest, self._azimuth = time, last
        age = (time - self._begun) % HOUR
        self._keep(age, packet)
        if self._covered >= FULL_TURN:
            return self._close(stamp)
        if age > LONGEST_TURN or len(self._packets) >= MOST_PACKETS:
            self._abandon()
        return None

    def finish(self, stamp: float) -> Scan | None:
        """The open turn, when no packet comes any more, if it lacks less than one packet."""
        if self._packets and self._covered + self._advance >= FULL_TURN:
            return self._close(stamp)
        return None

    def _checked(self, packet: bytes) -> Any:
        """The packet as a record, or None for one that is left out and counted."""
        if len(packet) != PACKET_SIZE:
            if len(packet) == POSITION_SIZE:
                self.skipped.position += 1
            else:
                self.skipped.other_size += 1
            return None
        read = np.frombuffer(packet, PACKET)[0]
        blocks, mode, product = read["blocks"], int(read["mode"]), int(read["product"])
        if (
            mode not in (STRONGEST, LAST, DUAL)
            or (blocks["flag"] != FLAG).any()
            or (blocks["azimuth"] >= FULL_TURN).any()
        ):
            self.skipped.damaged += 1
        elif product != self.product:
            self.skipped.other_product += 1
            self.products.add(product)
        elif self._single and mode == DUAL:
            self.skipped.dual += 1
        else:
            return read
        return None

    def _take_late(self, time: int, packet: bytes) -> None:
        """Adds a packet to the open turn if it is of this turn; the next one has begun, or it is older, otherwise."""
        self.skipped.late += 1
        self.skipped.lost = max(self.skipped.lost - 1, 0)
        age = (time - self._begun + HOUR // 2) % HOUR - HOUR // 2
        if self._packets and age >= 0:
            self._keep(age, packet)

    def _keep(self, age: int, packet: bytes) -> None:
        """Adds a packet to the open turn, as one of the model's product."""
        packet = packet[:-1] + self._own
        self._packets.append((age, packet, self._decode.unpack(packet)))

    def _abandon(self) -> None:
        self.skipped.incomplete += bool(self._packets)
        self._packets.clear()

    def _close(self, stamp: float) -> Scan | None:
        ordered = sorted(self._packets, key=lambda each: each[0])
        unpacked = {(age, packet): each for age, packet, each in ordered}  # a packet that came twice counts once
        packets = [packet for _, packet in unpacked]
        self._packets.clear()
        blocks = np.frombuffer(b"".join(packets), PACKET)["blocks"]
        azimuth = blocks["azimuth"].astype(np.int64)
        forth = (azimuth[1:, 0] - azimuth[:-1, -1]) % FULL_TURN  # turns that were sent one by one overlap: it is back
        if ((forth > WIDEST_GAP) & (forth < FULL_TURN - WIDEST_GAP)).any():
            self.skipped.incomplete += 1
            return None
        hit = blocks["returns"]["distance"] > 0
        if packets[0][-2] == DUAL:  # two blocks tell of the same rays
            hit = hit[:, ::2] | hit[:, 1::2]
        points = self._decode.points(list(unpacked.values()))
        return Scan(stamp, points, hit.size, hit.size - int(np.count_nonzero(hit)), len(packets))

    def trouble(self) -> str:
        """Why no scan came out, as a sentence's second half."""
        skipped = cast(dict[str, int], asdict(self.skipped))
        if skipped["other_product"]:
            byte = ", ".join(f"{product} (0x{product:02x})" for product in sorted(self.products))
            own = PRODUCTS[self.model]
            if self.product != own:
                return f"its packets carry the product byte {byte}, not the {self.product} of product={self.product}."
            return (
                f"its packets carry the product byte {byte}, and a {self.model} has {own}: name the model that sent "
                f"them, or if it is this one for sure give product={min(self.products)}."
            )
        if skipped["dual"]:
            return (
                "its packets hold two returns per ray, which only velodyne-decoder reads: "
                "pip install 'uavrl-onboard[lidar]'."
            )
        left_out = "; ".join(self.skipped.sentences()) or "too few packets for one turn"
        return f"it holds no full turn of a {self.model} ({left_out})."
