"""Captures of network traffic, as tcpdump and Wireshark write them, read and written by `dpkt`."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from functools import cache
from ipaddress import ip_address
from pathlib import Path
from typing import Any, NamedTuple

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.files import RecordFile, replacing
from uavrl_onboard.libraries import needed
from uavrl_onboard.lidar.packets import PORT

PCAP = (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d")  # how a file begins
PCAPNG = b"\x0a\x0d\x0d\x0a"
MOST_BYTES = 2**18  # of a captured packet, as tcpdump has it

_PACKET_HEADER = 32  # bytes at most, of a captured packet in the file
_ORDERS = {b"\x1a\x2b\x3c\x4d": ">", b"\x4d\x3c\x2b\x1a": "<"}  # of a section of pcapng
_INTERFACE, _PACKET = 1, 6  # kinds of its blocks
_RESOLUTION, _OFFSET = 9, 14  # options of an interface about its time stamps
_IP_LINKS = (12, 101, 228, 229)  # whose frames begin with IP
_UDP = 17  # protocol of IP
_LONGEST_DATAGRAM = 2**16  # bytes
_MOST_OPEN = 64  # datagrams of which some fragments have come
_LINKS = {0: "loopback.Loopback", 1: "ethernet.Ethernet", 108: "loopback.Loopback", 113: "sll.SLL", 276: "sll2.SLL2"}


@cache
def _dpkt(name: str) -> Any:
    """Return a class of `dpkt` by its name, such as ``"ip.IP"``."""
    module, _, kind = name.partition(".")
    return getattr(needed(f"dpkt.{module}", "A capture of network traffic", "lidar"), kind)


def read_datagrams(path: Path) -> Iterator[tuple[float, bytes, str]]:
    """Yield the time in seconds, the content and the sender of each UDP packet of a capture.

    Captures are pcap or pcapng; packets come one at a time.

    Everything but whole UDP packets is left out; those that were sent in fragments of IPv4 are joined. A capture that
    ends in the middle of a packet, or is damaged there, ends before it. A sender is ``ADDRESS:PORT``.

    Raises:
        UavrlError: for a file that is no capture, and if `dpkt` is not installed.
    """
    damage = (EOFError, ValueError, LookupError, struct.error, _dpkt("dpkt.Error"))
    with path.open("rb") as file:
        magic = file.read(4)
        if magic != PCAPNG and magic not in PCAP:
            raise UavrlError(f"{path} is no capture of network traffic: give a pcap or pcapng file.")
        file.seek(0)
        read = _pcapng_frames if magic == PCAPNG else _pcap_frames
        frames, fragments = read(RecordFile(file, MOST_BYTES + _PACKET_HEADER)), Fragments()
        while True:
            try:
                stamp, link, frame = next(frames)
            except (StopIteration, *damage):
                return
            layer = _network_layer(frame, link)
            datagram = _whole_datagram(layer) or fragments.join(layer)
            if datagram is not None:
                yield stamp, *datagram


def _pcap_frames(file: RecordFile) -> Iterator[tuple[float, int, bytes]]:
    reader = _dpkt("pcap.Reader")(file)
    link = reader.datalink() & 0xFFFF  # above it are flags
    file.next_record()
    for stamp, frame in reader:
        file.next_record()
        yield float(stamp), link, frame


class _Interface(NamedTuple):
    link: int
    unit: float  # of its time stamps, s
    offset: int  # s that are added to them


def _pcapng_frames(file: RecordFile) -> Iterator[tuple[float, int, bytes]]:
    """Yield the frames of all sections and interfaces.

    `dpkt.pcapng` takes all packets for those of the first interface, and its time grows with the square of a block's
    options: a file of 1 MB keeps it busy for ten seconds.
    """
    order, interfaces = "<", list[_Interface]()
    while True:
        file.next_record()
        head = file.read(8)
        if head[:4] == PCAPNG:  # a section, which says its byte order after its length
            head += file.read(4)
            order, interfaces = _ORDERS[head[8:]], []
        kind, length = struct.unpack(order + "II", head[:8])
        body = file.read(length - len(head))
        if kind == _INTERFACE and len(body) >= 8:
            interfaces.append(_interface(body, order))
        elif kind == _PACKET and len(body) >= 20:
            number, high, low, captured, _ = struct.unpack(order + "IIIII", body[:20])
            if number < len(interfaces) and captured <= len(body) - 20:
                link, unit, offset = interfaces[number]
                yield offset + (high * 2**32 + low) * unit, link, body[20 : 20 + captured]


def _interface(body: bytes, order: str) -> _Interface:
    """Return an interface of a section; its time stamps are in microseconds unless an option says otherwise."""
    unit, offset, at = 1e-6, 0, 8
    while at + 4 <= len(body):
        code, length = struct.unpack_from(order + "HH", body, at)
        value = body[at + 4 : at + 4 + length]
        if code == _RESOLUTION and length == len(value) == 1:
            exponent = value[0] & 127
            unit = 2.0**-exponent if value[0] & 128 else 10.0**-exponent
        elif code == _OFFSET and length == len(value) == 8:
            (offset,) = struct.unpack(order + "q", value)
        at += 4 + -(-length // 4) * 4
    return _Interface(struct.unpack(order + "H", body[:2])[0], unit, offset)


def udp_datagram(frame: bytes, link: int) -> tuple[bytes, str] | None:
    """Return what the UDP packet in a captured frame carries, and its sender; None unless there is a whole one.

    Args:
        frame: the captured bytes.
        link: the type of the link, by https://www.tcpdump.org/linktypes.html: Ethernet with or without VLAN, raw IP,
            Linux cooked (1 and 2) and loopback are known.
    """
    return _whole_datagram(_network_layer(frame, link))


def _network_layer(frame: bytes, link: int) -> Any:
    """Return the packet of IP in a captured frame; None where there is none."""
    if link in _IP_LINKS:
        layer = _parsed("ip6.IP6" if frame[:1] >= b"\x60" else "ip.IP", frame)
    else:
        layer = _parsed(_LINKS[link], frame) if link in _LINKS else None
    while layer is not None and not isinstance(layer, _dpkt("ip.IP") | _dpkt("ip6.IP6")):
        layer = getattr(layer, "data", None)  # of bytes: None
    return layer


def _whole_datagram(layer: Any) -> tuple[bytes, str] | None:
    """Return what a packet of IP carries as UDP, and its sender; None unless it is whole."""
    udp = getattr(layer, "data", None)
    if not isinstance(udp, _dpkt("udp.UDP")) or getattr(layer, "mf", False):  # more fragments follow
        return None
    content = bytes(udp.data[: max(udp.ulen - 8, 0)])
    if len(content) != udp.ulen - 8:
        return None
    return content, f"{ip_address(bytes(layer.src))}:{udp.sport}"


class Fragments:
    """Joins the fragments of IPv4 in which large UDP packets travel, as those of an Ouster do.

    Few datagrams are open at a time, and none takes more than one may have: a capture can be anyone's.
    """

    def __init__(self) -> None:
        self._open: dict[tuple[bytes, bytes, int], _Datagram] = {}  # in the order in which they began

    def join(self, layer: Any) -> tuple[bytes, str] | None:
        """Return the datagram that a fragment completes, and its sender; None for what is no fragment of UDP."""
        if not isinstance(layer, _dpkt("ip.IP")) or layer.p != _UDP or not (layer.mf or layer.offset):
            return None
        key, start, content = (layer.src, layer.dst, layer.id), 8 * layer.offset, bytes(layer.data)
        datagram = self._open.get(key, _Datagram({}, None, 0))
        if datagram.parts.get(start) == content:  # captured twice
            return None
        if start in datagram.parts or datagram.length + len(content) > _LONGEST_DATAGRAM:
            datagram = _Datagram({}, None, 0)  # the number was used again, or its lengths are a lie
        length = datagram.length + len(content)
        datagram.parts[start] = content
        end = datagram.end if layer.mf else start + len(content)
        self._open[key] = _Datagram(datagram.parts, end, length)
        if end is None or length < end:
            if len(self._open) > _MOST_OPEN:
                del self._open[next(iter(self._open))]
            return None
        del self._open[key]
        whole = b"".join(part for _, part in sorted(datagram.parts.items()))
        udp = _parsed("udp.UDP", whole)
        if udp is None or len(whole) != end or udp.ulen != end or not _are_contiguous(datagram.parts):
            return None
        return bytes(udp.data), f"{ip_address(bytes(layer.src))}:{udp.sport}"


class _Datagram(NamedTuple):
    parts: dict[int, bytes]  # by their beginning
    end: int | None  # bytes of all, once the last part has come
    length: int  # bytes so far


def _are_contiguous(parts: dict[int, bytes]) -> bool:
    return all(start + len(part) in parts for start, part in sorted(parts.items())[:-1])


def _parsed(name: str, data: bytes) -> Any:
    """Return what a class of `dpkt` reads; None for damaged data, which meets errors of many kinds in its parsers."""
    try:
        return _dpkt(name)(data)
    except UavrlError:
        raise
    except Exception:
        return None


def write_pcap(path: Path, packets: Iterable[tuple[float, bytes]], port: int = PORT) -> None:
    """Write packets, each with its time in seconds, as a capture of UDP from a sensor at 192.168.1.201.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "a.pcap"
        >>> write_pcap(file, [(1.5, b"hello")])
        >>> list(read_datagrams(file))
        [(1.5, b'hello', '192.168.1.201:2368')]
    """
    ethernet, ip, udp = _dpkt("ethernet.Ethernet"), _dpkt("ip.IP"), _dpkt("udp.UDP")
    with replacing(path) as partial, partial.open("wb") as file:
        writer = _dpkt("pcap.Writer")(file, snaplen=MOST_BYTES, nano=True)
        for stamp, packet in packets:
            sent = udp(sport=port, dport=port, ulen=len(packet) + 8, data=packet)
            routed = ip(src=bytes([192, 168, 1, 201]), dst=b"\xff" * 4, p=17, data=sent)
            writer.writepkt(ethernet(dst=b"\xff" * 6, src=bytes([0x60, 0x76, 0x88, 0, 0, 0]), data=routed), stamp)
