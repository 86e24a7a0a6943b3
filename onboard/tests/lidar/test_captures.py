"""Captures of a network: of every kind of link and file, and those that lie about their lengths."""

from __future__ import annotations

import struct
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.helpers.measured import measured

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.pcap import read_datagrams, udp_datagram, write_pcap

HELLO = b"hello"
UDP = struct.pack(">HHHH", 1, 2, 8 + len(HELLO), 0) + HELLO


def ipv4(content: bytes = UDP, fragment: int = 0x4000, protocol: int = 17) -> bytes:
    header = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(content), 7, fragment, 64, protocol, 0)
    return header + bytes([192, 168, 1, 201, 255, 255, 255, 255]) + content


def ipv6(content: bytes = UDP, following: int = 17) -> bytes:
    return struct.pack(">IHBB", 6 << 28, len(content), following, 64) + bytes(32) + content


def ethernet(content: bytes, kind: int = 0x0800, tags: bytes = b"") -> bytes:
    return bytes(12) + tags + struct.pack(">H", kind) + content


def vlan(identifier: int, kind: int = 0x8100) -> bytes:
    return struct.pack(">HH", kind, identifier)


OPTIONS = b"\x46" + ipv4()[1:2] + struct.pack(">H", 24 + len(UDP)) + ipv4()[4:20] + b"\x01" * 4 + UDP
HOPS = bytes([17, 0, 1, 4, 0, 0, 0, 0])  # an extension header of IPv6
WHOLE = {
    "Ethernet": (1, ethernet(ipv4())),
    "Ethernet, padded": (1, ethernet(ipv4()) + bytes(13)),
    "Ethernet, IPv6": (1, ethernet(ipv6(), 0x86DD)),
    "VLAN": (1, ethernet(ipv4(), tags=vlan(7))),
    "VLAN in VLAN": (1, ethernet(ipv4(), tags=vlan(7, 0x88A8) + vlan(8))),
    "raw IP": (101, ipv4()),
    "raw IP of OpenBSD": (12, ipv4()),
    "raw IPv6": (101, ipv6()),
    "IPv4": (228, ipv4()),
    "IPv4 with options": (228, OPTIONS),
    "IPv6": (229, ipv6()),
    "IPv6 with an extension": (229, ipv6(HOPS + UDP, 0)),
    "Linux cooked": (113, bytes(14) + b"\x08\x00" + ipv4()),
    "Linux cooked 2": (276, b"\x08\x00" + bytes(18) + ipv4()),
    "loopback": (0, struct.pack("<I", 2) + ipv4()),
    "loopback, big-endian": (0, struct.pack(">I", 2) + ipv4()),
    "loopback, IPv6": (0, struct.pack("<I", 30) + ipv6()),
    "loopback of OpenBSD": (108, struct.pack(">I", 2) + ipv4()),
}
FRAGMENT6 = struct.pack(">BBHI", 17, 0, 1, 7) + UDP[:10]
NOT_WHOLE = {
    "nothing": (1, b""),
    "a few bytes": (1, ethernet(ipv4())[:9]),
    "half a header": (101, ipv4()[:9]),
    "a cut packet": (1, ethernet(ipv4())[:40]),
    "a cut packet on loopback": (0, struct.pack("<I", 2) + ipv4()[:-1]),
    "zeros": (1, bytes(60)),
    "another link": (99, ethernet(ipv4())),
    "ARP": (1, ethernet(bytes(28), 0x0806)),
    "TCP": (101, ipv4(bytes(20), protocol=6)),
    "the first fragment": (1, ethernet(ipv4(fragment=0x2000))),
    "a later fragment": (1, ethernet(ipv4(fragment=0x0002))),
    "the first fragment of IPv6": (229, ipv6(FRAGMENT6, 44)),
    "a report of a lost packet": (101, ipv4(struct.pack(">BBHI", 3, 3, 0, 0) + ipv4(), protocol=1)),
    "longer than it is": (101, ipv4(struct.pack(">HHHH", 1, 2, 99, 0) + HELLO)),
    "shorter than its header": (101, ipv4(struct.pack(">HHHH", 1, 2, 7, 0) + HELLO)),
    "Ethernet in Ethernet, without end": (1, ethernet(b"", 0x6558) * 15_000),
    "IP in IP, without end": (101, b"".join(ipv4(bytes(20 * n), protocol=4)[:20] for n in range(3000, 0, -1))),
    "labels without end": (1, ethernet(bytes(4) * 5000, 0x8847)),
}


@pytest.mark.parametrize("name", WHOLE)
def test_a_packet_comes_out_of_every_link(name: str) -> None:
    link, frame = WHOLE[name]
    datagram = udp_datagram(frame, link)
    assert datagram is not None and datagram[0] == HELLO


@pytest.mark.parametrize("name", NOT_WHOLE)
def test_what_is_no_whole_packet_is_none(name: str) -> None:
    link, frame = NOT_WHOLE[name]
    assert udp_datagram(frame, link) is None


# ---------------------------------------------------------------------- fragments


LARGE = bytes(range(256)) * 60


def fragments(content: bytes = LARGE, number: int = 7, size: int = 1480) -> list[bytes]:
    """The frames of one datagram of UDP that is larger than the network carries."""
    whole = struct.pack(">HHHH", 7502, 7502, 8 + len(content), 0) + content
    found = []
    for start in range(0, len(whole), size):
        part, more = whole[start : start + size], 0x2000 * (start + size < len(whole))
        frame = bytearray(ethernet(ipv4(part, more | start // 8)))
        frame[18:20] = number.to_bytes(2, "big")
        found.append(bytes(frame))
    return found


def contents(folder: Path, frames: list[bytes]) -> list[bytes]:
    path = folder / "a.pcap"
    path.write_bytes(pcap(*((n, 0, frame) for n, frame in enumerate(frames))))
    return [content for _, content, _ in read_datagrams(path)]


def test_fragments_are_joined_in_any_order_and_between_others(tmp_path: Path) -> None:
    one, two = fragments(LARGE, 7), fragments(LARGE[::-1], 8)
    mixed = [frame for pair in zip(one, two, strict=True) for frame in pair]
    assert contents(tmp_path, [*mixed, FRAME]) == [LARGE, LARGE[::-1], HELLO]
    assert contents(tmp_path, one[::-1]) == [LARGE]
    assert contents(tmp_path, [frame for frame in one for _ in range(2)]) == [LARGE], "each captured twice"


def test_fragments_that_are_not_all_there_are_left_out(tmp_path: Path) -> None:
    one, two = fragments(LARGE, 7), fragments(LARGE[::-1], 7)
    assert contents(tmp_path, one[:-1] + two) == [LARGE[::-1]], "the number was used again"
    assert contents(tmp_path, one[1:]) == []
    assert contents(tmp_path, one[:3] + one[4:]) == []
    overlapping = bytearray(one[1])
    overlapping[20:22] = (0x2000 | 8).to_bytes(2, "big")
    assert contents(tmp_path, [*one[:1], bytes(overlapping), *one[2:]]) == []


def test_fragments_without_end_take_no_memory(tmp_path: Path) -> None:
    """Of many datagrams, and of one whose parts overlap each other."""
    begun = [ethernet(ipv4(bytes(60_000), 0x2000)) for _ in range(300)]
    frames = [frame[:18] + number.to_bytes(2, "big") + frame[20:] for number, frame in enumerate(begun)]
    frames += [ethernet(ipv4(bytes(30_000), 0x2000 | start // 8)) for start in range(0, 65_000, 80)]
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(*((n, 0, frame) for n, frame in enumerate(frames))))
    tracemalloc.start()
    assert list(read_datagrams(path)) == []
    assert tracemalloc.get_traced_memory()[1] < 10e6, "64 datagrams of 60 kB, and what is read"
    tracemalloc.stop()


# ---------------------------------------------------------------------- files

FRAME = ethernet(ipv4())


def pcap(*frames: tuple[int, int, bytes], order: str = "<", magic: int = 0xA1B2C3D4, link: int = 1) -> bytes:
    """A file of frames, each with its seconds and what follows the point, in the file's unit."""
    head = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 2**18, link)
    packets = (struct.pack(order + "IIII", s, part, len(f), len(f)) + f for s, part, f in frames)
    return head + b"".join(packets)


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    body += bytes(-len(body) % 4)
    length = struct.pack(order + "I", len(body) + 12)
    return struct.pack(order + "I", kind) + length + body + length


def section(order: str = "<") -> bytes:
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(link: int = 1, options: bytes = b"", order: str = "<") -> bytes:
    return block(1, struct.pack(order + "HHI", link, 0, 0) + options, order)


def option(code: int, value: bytes, order: str = "<") -> bytes:
    return struct.pack(order + "HH", code, len(value)) + value + bytes(-len(value) % 4)


def packet(ticks: int, frame: bytes = FRAME, number: int = 0, order: str = "<", more: bytes = b"") -> bytes:
    high, low = divmod(ticks, 2**32)
    head = struct.pack(order + "IIIII", number, high, low, len(frame), len(frame))
    return block(6, head + frame + bytes(-len(frame) % 4) + more, order)


END = bytes(4)
NANO = option(9, b"\x09")
MIXED = (
    section()
    + interface()
    + interface(101, NANO + END)
    + packet(1_500_000)
    + packet(2_500_000_000, ipv4(), 1)
    + block(5, bytes(12))  # statistics
    + packet(9, number=2)  # of an interface that is not there
    + section(">")
    + interface(113, option(14, struct.pack(">q", 100), ">") + END, ">")
    + packet(3_500_000, WHOLE["Linux cooked"][1], order=">")
)
FILES: dict[str, tuple[bytes, list[float]]] = {
    "microseconds": (pcap((1, 500_000, FRAME), (2, 1, b"no packet")), [1.5]),
    "nanoseconds": (pcap((1, 250_000_000, FRAME), magic=0xA1B23C4D), [1.25]),
    "big-endian": (pcap((1, 500_000, FRAME), order=">"), [1.5]),
    "big-endian nanoseconds": (pcap((1, 500_000_000, FRAME), order=">", magic=0xA1B23C4D), [1.5]),
    "raw IP, with flags over its link": (pcap((7, 0, ipv4()), link=101 | 0x0400_0000), [7.0]),
    "pcapng": (section() + interface() + packet(1_500_000), [1.5]),
    "pcapng, big-endian": (section(">") + interface(order=">") + packet(1_500_000, order=">"), [1.5]),
    "pcapng in halves of a second": (section() + interface(1, option(9, b"\x81") + END) + packet(3), [1.5]),
    "pcapng with a comment": (section() + interface() + packet(1_500_000, more=option(1, b"seen") + END), [1.5]),
    "pcapng of several interfaces and sections": (MIXED, [1.5, 2.5, 103.5]),
}


def read(path: Path, content: bytes) -> list[tuple[float, bytes]]:
    path.write_bytes(content)
    return [(stamp, content) for stamp, content, _ in read_datagrams(path)]


@pytest.mark.parametrize("name", FILES)
def test_every_kind_of_file_gives_times_and_packets(name: str, tmp_path: Path) -> None:
    content, times = FILES[name]
    found = read(tmp_path / "a", content)
    assert [stamp for stamp, _ in found] == pytest.approx(times, abs=1e-9) and {data for _, data in found} == {HELLO}


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_cut_anywhere_gives_what_came_before(name: str, tmp_path: Path) -> None:
    content, times = FILES[name]
    counts = [len(read(tmp_path / "a", content[:end])) for end in range(4, len(content) + 1)]
    assert counts == sorted(counts) and (counts[0], counts[-1]) == (0, len(times))


def large(size: int) -> bytes:
    """Zeros behind a length that says more, or less than nothing."""
    return bytes(size)


LYING: dict[str, tuple[Callable[[], bytes], int]] = {
    "a frame of 4 GB": (lambda: FILES["microseconds"][0] + struct.pack("<IIII", 1, 1, 2**32 - 1, 60) + large(2**25), 1),
    "a frame of 1 MB": (lambda: FILES["microseconds"][0] + struct.pack("<IIII", 1, 1, 2**20, 60) + large(2**25), 1),
    "a block of 4 GB": (lambda: FILES["pcapng"][0] + struct.pack("<II", 6, 2**32 - 4) + large(2**25), 1),
    "a block of less than its head": (lambda: FILES["pcapng"][0] + struct.pack("<II", 6, 4) + large(2**25), 1),
    "a section of 4 GB": (lambda: struct.pack("<III", 0x0A0D0D0A, 2**32 - 4, 0x1A2B3C4D) + large(2**25), 0),
    "a section of no byte order": (lambda: struct.pack("<III", 0x0A0D0D0A, 28, 7) + large(2**25), 0),
    "blocks of nothing": (lambda: FILES["pcapng"][0] + struct.pack("<II", 5, 8) * 50_000 + packet(1), 2),
}


@pytest.mark.parametrize("name", LYING)
def test_a_length_that_lies_takes_no_memory(name: str, tmp_path: Path) -> None:
    content, packets = LYING[name]
    (tmp_path / "a").write_bytes(content())
    tracemalloc.start()
    try:
        assert len(list(read_datagrams(tmp_path / "a"))) == packets
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


DAMAGED = {
    "a frame that is longer than its block": packet(1)[:20] + struct.pack("<I", 5000) + packet(1)[24:],
    "half an option": packet(1, more=b"\x01\x00"),
    "an interface that is cut": block(1, bytes(4)),
    "an interface of half an option": interface(1, option(9, b"\x09") + b"\x0e\x00"),
    "an interface whose option is longer than it": interface(1, struct.pack("<HH", 9, 500)),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_block_costs_no_other(name: str, tmp_path: Path) -> None:
    found = read(tmp_path / "a", section() + interface() + DAMAGED[name] + packet(2_000_000))
    assert found[-1] == (2.0, HELLO) and len(found) <= 2


@measured
def test_options_without_end_come_to_an_end(tmp_path: Path) -> None:
    """Some would take time by the square of their number: minutes for this file."""
    many = option(2, b"") * 60_000
    begun = time.process_time()
    assert len(read(tmp_path / "a", section() + 10 * interface(1, many) + 100 * packet(1, more=many))) == 100
    assert time.process_time() - begun < 30


def test_another_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"text")
    with pytest.raises(UavrlError, match="a is no capture of network traffic: give a pcap or pcapng file"):
        list(read_datagrams(tmp_path / "a"))


def test_what_is_written_comes_back_to_a_microsecond(tmp_path: Path) -> None:
    packets = [(1.7e9 + 0.001327 * number, bytes([number]) * 1206) for number in range(20)]
    write_pcap(tmp_path / "a.pcap", packets)
    found = list(read_datagrams(tmp_path / "a.pcap"))
    assert [data for _, data, _ in found] == [data for _, data in packets]
    assert {sender for _, _, sender in found} == {"192.168.1.201:2368"}
    assert [stamp for stamp, _, _ in found] == pytest.approx([stamp for stamp, _ in packets], rel=0, abs=1e-6)
