"""Captures of network traffic, as tcpdump and Wireshark write them: what UDP carried, read and written."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from ipaddress import ip_address
from pathlib import Path
from typing import BinaryIO

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.files import replacing
from uavrl_onboard.lidar.packets import PORT

PCAP = {b"\xd4\xc3\xb2\xa1": ("<", 1e-6), b"\xa1\xb2\xc3\xd4": (">", 1e-6)}  # byte order and unit of time
PCAP |= {b"\x4d\x3c\xb2\xa1": ("<", 1e-9), b"\xa1\xb2\x3c\x4d": (">", 1e-9)}
PCAPNG = b"\x0a\x0d\x0d\x0a"
MOST_BYTES = 2**18  # of a captured packet, as tcpdump has it

_ETHERNET, _IPV4, _UDP = 1, 0x0800, 17
_LINK_HEADERS = {0: 4, _ETHERNET: 14, 12: 0, 101: 0, 113: 16, 228: 0, 229: 0, 276: 20}  # bytes before IP begins
_VLANS = (0x8100, 0x88A8)


def read_pcap(path: Path) -> Iterator[tuple[float, bytes]]:
    """The time in seconds and the content of each UDP packet of a capture, as of `read_datagrams`."""
    for stamp, content, _ in read_datagrams(path):
        yield stamp, content


def read_datagrams(path: Path) -> Iterator[tuple[float, bytes, str]]:
    """The time in seconds, the content and the sender of each UDP packet of a capture (pcap or pcapng).

    They come one at a time. What is no whole UDP packet is left out. A capture that ends in the middle of a packet ends
    before it. A sender is ``ADDRESS:PORT``.
    """
    with path.open("rb") as file:
        magic = file.read(4)
        if magic == PCAPNG:
            frames = _pcapng_frames(file)
        elif magic in PCAP:
            frames = _pcap_frames(file, *PCAP[magic])
        else:
            raise UavrlError(f"{path} is no capture of network traffic: give a pcap or pcapng file.")
        for stamp, link, frame in frames:
            datagram = udp_datagram(frame, link)
            if datagram is not None:
                yield stamp, *datagram


def _pcap_frames(file: BinaryIO, order: str, unit: float) -> Iterator[tuple[float, int, bytes]]:
    header = file.read(20)
    if len(header) < 20:
        return
    link = struct.unpack(order + "HHiIII", header)[-1] & 0xFFFF
    while len(head := file.read(16)) == 16:
        seconds, fraction, length, _ = struct.unpack(order + "IIII", head)
        if length > MOST_BYTES:
            return
        frame = file.read(length)
        if len(frame) < length:
            return
        yield seconds + fraction * unit, link, frame


def _pcapng_frames(file: BinaryIO) -> Iterator[tuple[float, int, bytes]]:
    order, interfaces = "<", list[tuple[int, float]]()
    file.seek(0)
    while len(head := file.read(8)) == 8:
        if head[:4] == PCAPNG:  # a section, which says its byte order after its length
            magic = file.read(4)
            order, interfaces = ("<" if magic == b"\x4d\x3c\x2b\x1a" else ">"), []
            kind, length, read = 0, struct.unpack(order + "I", head[4:])[0], 12
        else:
            (kind, length), read = struct.unpack(order + "II", head), 8
        if not 12 <= length <= MOST_BYTES or len(body := file.read(length - read)) < length - read:
            return
        if kind == 1 and len(body) >= 8:
            interfaces.append((struct.unpack(order + "H", body[:2])[0], _time_unit(body[8:-4], order)))
        elif kind == 6 and len(body) >= 20:
            number, high, low, captured, _ = struct.unpack(order + "IIIII", body[:20])
            if number < len(interfaces) and captured <= len(body) - 20:
                link, unit = interfaces[number]
                yield (high * 2**32 + low) * unit, link, body[20 : 20 + captured]


def _time_unit(options: bytes, order: str) -> float:
    """Of an interface's time stamps in seconds; a microsecond unless it says something else."""
    while len(options) >= 4:
        code, length = struct.unpack(order + "HH", options[:4])
        if code == 9 and length == 1 and len(options) > 4:
            return 2.0 ** -(options[4] & 127) if options[4] & 128 else 10.0 ** -options[4]
        options = options[4 + -(-length // 4) * 4 :]
    return 1e-6


def udp_content(frame: bytes, link: int) -> bytes | None:
    """What the UDP packet in a captured frame carries; None where there is no whole one."""
    datagram = udp_datagram(frame, link)
    return None if datagram is None else datagram[0]


def udp_datagram(frame: bytes, link: int) -> tuple[bytes, str] | None:
    """What the UDP packet in a captured frame carries, and its sender; None where there is no whole one."""
    start = _LINK_HEADERS.get(link)
    if start is None or len(frame) < start + 20:
        return None
    if link == _ETHERNET:
        while int.from_bytes(frame[start - 2 : start], "big") in _VLANS:
            start += 4
    version = frame[start] >> 4 if len(frame) > start else 0
    if version == 4 and frame[start + 9 : start + 10] == bytes([_UDP]):
        fragment = int.from_bytes(frame[start + 6 : start + 8], "big") & 0x3FFF
        udp, source = start + 4 * (frame[start] & 15), frame[start + 12 : start + 16]
    elif version == 6 and frame[start + 6 : start + 7] == bytes([_UDP]):
        fragment, udp, source = 0, start + 40, frame[start + 8 : start + 24]
    else:
        return None
    length = int.from_bytes(frame[udp + 4 : udp + 6], "big")
    content = frame[udp + 8 : udp + length]
    if fragment or length < 8 or len(content) != length - 8:
        return None
    return content, f"{ip_address(source)}:{int.from_bytes(frame[udp : udp + 2], 'big')}"


def write_pcap(path: Path, packets: Iterable[tuple[float, bytes]], port: int = PORT) -> None:
    """Writes packets, each with its time in seconds, as a capture of UDP from a sensor at 192.168.1.201.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "a.pcap"
        >>> write_pcap(file, [(1.5, b"hello")])
        >>> list(read_pcap(file))
        [(1.5, b'hello')]
    """
    with replacing(path) as partial, partial.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, MOST_BYTES, _ETHERNET))
        for stamp, packet in packets:
            udp = struct.pack(">HHHH", port, port, len(packet) + 8, 0)  # 0: no checksum
            ip = struct.pack(">BBHHHBBH", 0x45, 0, len(packet) + 28, 0, 0x4000, 64, _UDP, 0)
            ip += bytes([192, 168, 1, 201, 255, 255, 255, 255])
            ip = ip[:10] + struct.pack(">H", _checksum(ip)) + ip[12:]
            frame = b"\xff" * 6 + bytes([0x60, 0x76, 0x88, 0, 0, 0]) + struct.pack(">H", _IPV4) + ip + udp + packet
            seconds, nanoseconds = divmod(round(stamp * 1e9), 10**9)
            file.write(struct.pack("<IIII", seconds, nanoseconds, len(frame), len(frame)) + frame)


def _checksum(header: bytes) -> int:
    """The Internet checksum of a header whose own checksum is 0 (RFC 1071)."""
    total = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
