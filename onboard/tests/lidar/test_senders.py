"""Two sensors on one port, or in one capture, are not one."""

from __future__ import annotations

import itertools
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.ports import free_ports

from uavrl_onboard.lidar.packets import encode_scan
from uavrl_onboard.lidar.pcap import read_datagrams, write_pcap
from uavrl_onboard.lidar.scans import ScanAssembler
from uavrl_onboard.lidar.senders import OneSender
from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.lidar.udp_scans import UdpScans
from uavrl_onboard.lidar.vlp16 import firing_directions

OURS, ADDRESS = bytes([192, 168, 1, 201]), "192.168.1.201:2368"


def turns(far: float, count: int = 3, first: int = 0) -> list[bytes]:
    numbers = range(first, first + count)
    return [packet for n in numbers for packet in encode_scan(far * firing_directions(), stamp=0.1 * n)]


def capture(path: Path, other: bytes, port: int) -> Path:
    """Packets of a sensor 2 m from everything, each followed by one of another sensor that sees everything at 9 m."""
    both = [each for pair in zip(turns(2.0), turns(9.0), strict=True) for each in pair]
    write_pcap(path, [(0.0006 * n, packet) for n, packet in enumerate(both)])
    content, frame = bytearray(path.read_bytes()), 16 + 42 + 1206
    for start in range(24 + frame, len(content), 2 * frame):
        content[start + 16 + 26 : start + 16 + 30] = other
        content[start + 16 + 34 : start + 16 + 36] = port.to_bytes(2, "big")
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("other", "port", "address"),
    [(bytes([192, 168, 1, 202]), 2368, "192.168.1.202:2368"), (OURS, 2369, "192.168.1.201:2369")],
)
def test_of_two_sensors_in_a_capture_one_is_read(other: bytes, port: int, address: str, tmp_path: Path) -> None:
    path = capture(tmp_path / "a.pcap", other, port)
    assert [sender for _, _, sender in read_datagrams(path)][:3] == [ADDRESS, address, ADDRESS]
    source = ScanSource(path, "VLP16")
    scans = list(source)
    assert len(scans) == 3
    for scan in scans:
        assert len(scan.points) <= 29184 and np.sqrt((scan.points**2).sum(-1)).max() == pytest.approx(2.0, abs=0.002)
    assert source.skipped.other_sender == 3 * 76
    assert source.remarks() == [
        "left out: 228 packets of a second sender",
        f"Two senders: only {ADDRESS} is read, and the packets of {address} are left out.",
    ]


def test_a_listener_reads_one_of_two_senders_from_one_address() -> None:
    port, _ = free_ports()
    source, ended = ScanSource(f"udp://127.0.0.1:{port}", "VLP16", seconds=20.0), threading.Event()

    def send() -> None:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far,
        ):
            for turn in itertools.count():  # a busy machine loses packets of some
                pairs = list(zip(turns(2.0, 1, turn), turns(9.0, 1, turn), strict=True))
                for first in range(0, len(pairs), 19):
                    for one, other in pairs[first : first + 19]:
                        near.sendto(one, ("127.0.0.1", port))
                        far.sendto(other, ("127.0.0.1", port))
                    if ended.wait(0.005):
                        return

    sending = threading.Thread(target=send)
    sending.start()
    try:
        scan = next(iter(source))
    finally:
        ended.set()
        sending.join()
    far = np.sqrt((scan.points**2).sum(-1))
    assert np.ptp(far) < 0.01, "of one place"
    assert source.remarks()[-1].startswith("Two senders: only 127.0.0.1:")


def test_a_second_sender_from_the_sensor_s_address_is_left_out_and_told() -> None:
    port, _ = free_ports()
    feed = UdpScans(f"udp://127.0.0.1:{port}", "VLP16")
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        for near, far in zip(turns(2.0, 1), turns(9.0, 1), strict=True):
            ours.sendto(near, ("127.0.0.1", port))
            other.sendto(far, ("127.0.0.1", port))
        scan = feed.poll(time.monotonic())
        assert scan is not None and np.sqrt((scan.points**2).sum(-1)).max() == pytest.approx(2.0, abs=0.002)
        names = ["{}:{}".format(*each.getsockname()).replace("0.0.0.0", "127.0.0.1") for each in (ours, other)]
        told = f"Two senders: only {names[0]} is read, and the packets of {names[1]} are left out."
        assert feed.remarks() == [told] and feed.skipped.other_sender == 76
    feed.close()


def test_the_sender_is_one_of_the_sensor_s_product_and_another_follows_its_silence() -> None:
    packet = turns(2.0, 1)[0]
    senders, foreign = OneSender(ScanAssembler("VLP16")), packet[:-1] + b"\x21"
    assert senders.takes("a:1", foreign, 0.0) and senders.taken is None, "left to what counts other products"
    assert senders.takes("b:1", packet, 0.1) and not senders.takes("a:1", foreign, 0.2)
    assert senders.takes("a:8308", bytes(512), 0.2), "position packets come from another port"
    assert not senders.takes("c:1", packet, 1.1) and senders.takes("c:1", packet, 1.11) and senders.taken == "c:1"
    assert senders.sentence() == "Two senders: only c:1 is read, and the packets of a:1 are left out."
