"""One iterator of scans for all sources: a sensor by UDP, a capture, packets in a file, recordings of ROS."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar import bags
from uavrl_onboard.lidar.assemblers import make_assembler
from uavrl_onboard.lidar.packets import FLAG, HOUR, PACKET_SIZE
from uavrl_onboard.lidar.pcap import PCAP, PCAPNG, read_datagrams
from uavrl_onboard.lidar.scans import Assembler, Scan, Skipped
from uavrl_onboard.lidar.senders import OneSender
from uavrl_onboard.lidar.udp import NOTHING_CAME, address, read_udp
from uavrl_onboard.pluralize import pluralize

_RECORDINGS = (b"\x89MCAP0\r\n", b"SQLite format 3\0", bags.ROSBAG1)
_OSF = b"OSF$"  # from the ninth byte on, of a recording by ouster-sdk
_TURN = 0.1  # s of most sensors
_LEAST = 0.001  # s from one scan to the next, at least
_BATCH = 1000  # packets that are read from a file at once
KINDS = (
    "udp://:PORT, a capture (.pcap), packets alone (.bin, 1,206 bytes each), a rosbag of ROS 1 (.bag), a rosbag of "
    "ROS 2 (its folder, or its .db3 or .mcap)"
)


class ScanSource:
    """The scans of a source, one after the other, as ``(stamp, points)``.

    Points are ``float32 [P, 3]`` in metres in the sensor frame: x forward, y left, z up. Of packets only returns come;
    a driver's cloud may hold misses, as NaN, infinity or zeros (`uavrl_onboard.geometry.is_return`).

    Args:
        source: ``udp://:2368``, or a file or folder.
        model: of the Velodyne that sent the packets, such as ``"VLP16"``; a PointCloud2 needs none.
        topic: of a recording of ROS that has several with scans.
        product: the product byte of a sensor whose packets carry another than its model's.
        seconds: how long to listen to UDP; None for as long as packets come.
        metadata: file with the metadata of the Ouster that sent the packets, instead of a model.

    Attributes:
        skipped: how much was left out so far, by reason.
        clock: what gives the messages of a recording their times.

    Raises:
        UavrlError: for a source of no known kind, one without a scan, or another model than the packets are of.

    Examples:
        >>> import tempfile
        >>> from uavrl_onboard.lidar.packets import encode_scan
        >>> from uavrl_onboard.lidar.vlp16 import firing_directions
        >>> file = Path(tempfile.mkdtemp()) / "one.bin"
        >>> _ = file.write_bytes(b"".join(encode_scan(3.0 * firing_directions())))
        >>> [points.shape for stamp, points in ScanSource(file, "VLP16")]
        [(28928, 3)]
    """

    def __init__(
        self,
        source: str | Path,
        model: str | None = None,
        *,
        topic: str | None = None,
        product: int | None = None,
        seconds: float | None = None,
        metadata: str | Path | None = None,
    ) -> None:
        self.source, self.seconds = str(source), seconds
        self._sensor = model, product, metadata
        self.skipped, self.clock = Skipped(), bags.RecordedClock()
        self._senders: OneSender | None = None
        self._standing = 0  # scans of a capture that have the time of the one before
        self.topic: bags.Topic | None = None
        if self.source.startswith("udp:"):
            address(self.source)
            self.kind = "udp"
        else:
            self.kind = _kind(Path(source))
        if self.kind == "ros":
            self.topic = bags.scan_topic(Path(source), topic)
        if self.topic is None or self.topic.kind == bags.SCAN:
            make_assembler(*self._sensor)  # which refuses a sensor that it does not know

    def __iter__(self) -> Iterator[Scan]:
        """Reads the source from its beginning."""
        self.clock = bags.RecordedClock()
        if self.topic is not None and self.topic.kind == bags.CLOUD:
            scans = bags.read_clouds(Path(self.source), self.topic.name, self.skipped, self.clock)
            yield from self._some(scans, "it holds no cloud that can be read.")
            return
        assembler = make_assembler(*self._sensor)
        assembler.skipped = self.skipped
        self._senders = OneSender(assembler)
        scans = self._assembled(assembler, self._senders)
        yield from self._some(self._advancing(scans) if self.kind == "pcap" else scans, "", assembler)

    def remarks(self) -> list[str]:
        """What the user should know of what was read so far: what was left out, and what is odd."""
        told = [f"left out: {reason}" for reason in self.skipped.sentences()]
        if self._standing:
            scans = pluralize(self._standing, "scan")
            told.append(f"the capture's clock stands still: {scans} of it count as {_TURN} s after the one before.")
        odd = (self.clock.sentence(), None if self._senders is None else self._senders.sentence())
        return told + [sentence for sentence in odd if sentence is not None]

    def _advancing(self, scans: Iterator[Scan]) -> Iterator[Scan]:
        """The scans, one after the other, of a capture whose program has written no times, or whole seconds."""
        before, given, self._standing = -math.inf, -math.inf, 0
        for scan in scans:
            if scan.stamp == before:
                self._standing += 1
                given += _TURN
            elif before < scan.stamp <= given:  # the capture's clock catches up
                given += _LEAST
            else:
                given = scan.stamp
            before = scan.stamp
            yield replace(scan, stamp=given)

    def _assembled(self, assembler: Assembler, senders: OneSender) -> Iterator[Scan]:
        stamp = 0.0
        for stamp, packet, sender in self._packets(assembler.port):
            if not senders.takes(sender, packet, stamp):
                self.skipped.other_sender += 1
                continue
            scan = assembler.push(stamp, packet)
            if scan is not None:
                yield scan
        scan = assembler.finish(stamp)
        if scan is not None:
            yield scan

    def _some(self, scans: Iterator[Scan], why: str, assembler: Assembler | None = None) -> Iterator[Scan]:
        """The scans, or why there is none."""
        empty = True
        for scan in scans:
            empty = False
            yield scan
        if empty:
            raise UavrlError(f"{self.source} gave no scan: {why if assembler is None else self._trouble(assembler)}")

    def _trouble(self, assembler: Assembler) -> str:
        if self.kind == "udp" and not assembler.heard:
            return NOTHING_CAME
        return assembler.trouble()

    def _packets(self, port: int) -> Iterator[tuple[float, bytes, str]]:
        """The packets, each with its time and its sender, of which a file may know nothing."""
        path = Path(self.source)
        if self.kind == "udp":
            yield from read_udp(self.source, self.seconds, port=port)
        elif self.kind == "pcap":
            yield from read_datagrams(path)
        elif self.topic is None:
            yield from ((stamp, packet, "") for stamp, packet in read_bare(path))
        else:
            packets = bags.read_packets(path, self.topic.name, self.skipped, self.clock)
            yield from ((stamp, packet, "") for stamp, packet in packets)


def read_bare(path: Path) -> Iterator[tuple[float, bytes]]:
    """The packets of a file that holds nothing else, with the sensor's own time in seconds past the first one's hour.

    The sensor counts from 0 in each hour, and this goes on.
    """
    before = hours = 0
    with path.open("rb") as file:
        while batch := file.read(_BATCH * PACKET_SIZE):
            for start in range(0, len(batch), PACKET_SIZE):
                packet = batch[start : start + PACKET_SIZE]
                time = int.from_bytes(packet[-6:-2], "little")
                hours += (time - before < -HOUR // 2) - (time - before > HOUR // 2 and hours > 0)
                before = time
                yield (hours * HOUR + time) * 1e-6, packet


def _kind(path: Path) -> str:
    """What a file is, by how it begins."""
    if not path.exists():
        raise UavrlError(f"There is no {path}: give {KINDS}.")
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "ros"
        raise UavrlError(f"{path} is a folder without metadata.yaml, so no rosbag of ROS 2: give {KINDS}.")
    with path.open("rb") as file:
        begins = file.read(16)
    if begins[:4] in PCAP or begins[:4] == PCAPNG:
        return "pcap"
    if begins.startswith(_RECORDINGS):
        return "ros"
    if begins[:2] == FLAG.to_bytes(2, "little"):
        return "bare"
    if begins[8:12] == _OSF:
        raise UavrlError(
            f"{path} is a recording of Ouster's own kind (OSF): make a capture and its metadata of it with ouster-cli "
            f"source {path} save {path.with_suffix('.pcap').name}."
        )
    raise UavrlError(f"{path} {'is empty' if not begins else 'is of no known kind'}: give {KINDS}.")


def without_vehicle(
    points: np.ndarray, low: np.ndarray, high: np.ndarray, sensor: np.ndarray | None = None
) -> np.ndarray:
    """The points ``[P, 3]`` that do not lie in a box around the vehicle, whose legs and rotors its own LiDAR sees.

    Args:
        points: in the sensor frame, in m.
        low: the box's least corner ``[3]`` in body axes, in m.
        high: its greatest corner.
        sensor: where the sensor is in body axes, ``[3]``; None for a box that is given from the sensor.

    Examples:
        >>> seen = np.array([[0.2, 0.0, -0.3], [2.0, 0.0, 0.0]])
        >>> without_vehicle(seen, np.full(3, -0.4), np.full(3, 0.4)).tolist()
        [[2.0, 0.0, 0.0]]
    """
    at = points if sensor is None else points + np.asarray(sensor, points.dtype)
    outside = np.zeros(len(at), bool)
    for axis, least, greatest in zip(at.T, low, high, strict=True):
        outside |= ~((axis >= least) & (axis <= greatest))
    return points if outside.all() else points.take(np.flatnonzero(outside), axis=0)
