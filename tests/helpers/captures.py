"""The same packets in every kind of file that is read."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

from tests.helpers.packets import turns
from tests.helpers.recordings import SCAN, scan_message, store, write_bag
from uavrl_onboard.lidar.pcap import write_pcap

PACKETS = turns(3)
TIMES = [100.0 + 0.001327 * n for n in range(len(PACKETS))]


def bare(folder: Path) -> Path:
    path = folder / "a.bin"
    path.write_bytes(b"".join(PACKETS))
    return path


def captured(folder: Path) -> Path:
    write_pcap(folder / "a.pcap", zip(TIMES, PACKETS, strict=True))
    return folder / "a.pcap"


def capture_of(folder: Path, blocks: Callable[[list[bytes]], bytes]) -> Path:
    frames = [frame for _, _, frame in frames_of(captured(folder))]
    (folder / "b.pcap").write_bytes(blocks(frames))
    return folder / "b.pcap"


def frames_of(path: Path) -> list[tuple[float, int, bytes]]:
    content, start, found = path.read_bytes(), 24, []
    while start < len(content):
        seconds, fraction, length, _ = struct.unpack_from("<IIII", content, start)
        found.append((seconds + fraction * 1e-9, 1, content[start + 16 : start + 16 + length]))
        start += 16 + length
    return found


def big_endian_capture(folder: Path) -> Path:
    def blocks(frames: list[bytes]) -> bytes:
        heads = [
            struct.pack(">IIII", int(t), round(t % 1 * 1e6), len(f), len(f)) for t, f in zip(TIMES, frames, strict=True)
        ]
        body = b"".join(head + frame for head, frame in zip(heads, frames, strict=True))
        return struct.pack(">IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1) + body

    return capture_of(folder, blocks)


def next_generation_capture(folder: Path) -> Path:
    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)

    def blocks(frames: list[bytes]) -> bytes:
        section = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
        interface = block(1, struct.pack("<HHI", 1, 0, 0) + struct.pack("<HHB3x", 9, 1, 9) + bytes(4))
        packets = b""
        for stamp, frame in zip(TIMES, frames, strict=True):
            high, low = divmod(round(stamp * 1e9), 2**32)
            packets += block(6, struct.pack("<IIIII", 0, high, low, len(frame), len(frame)) + frame)
        return section + interface + block(5, bytes(12)) + packets

    return capture_of(folder, blocks)


def recorded(kind: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        messages = [
            scan_message(store(kind == "ros1"), PACKETS[n : n + 76], 100.0 + 0.001327 * n)
            for n in range(0, len(PACKETS), 76)
        ]
        return write_bag(
            folder / f"a.{'bag' if kind == 'ros1' else kind}", kind, {"/velodyne_packets": (SCAN, messages)}
        )

    return write


KINDS = {
    "bin": bare, "pcap": captured, "pcap, big-endian": big_endian_capture, "pcapng": next_generation_capture,
    "rosbag1": recorded("ros1"), "rosbag2": recorded("db3"), "mcap": recorded("mcap"),
}  # fmt: skip
