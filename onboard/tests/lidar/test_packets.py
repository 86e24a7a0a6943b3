"""Scans as the packets of a VLP-16, and back."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.packets import PACKET, PacketStream, decode_vlp16, encode_scan
from uavrl_onboard.lidar.scans import ScanAssembler, make_decoder
from uavrl_onboard.lidar.vlp16 import FIRING_TIMES, firing_directions


def wall(distance: float = 3.0) -> np.ndarray:
    return distance * firing_directions()


def test_the_first_block_is_written_as_the_manual_says() -> None:
    scan = wall(2.0)
    scan[1] = np.nan
    first = encode_scan(scan, stamp=3600.0 + 0.25)[0]
    assert first[:10].hex() == "ffee" + "0000" + "e80364" + "000000"  # flag, azimuth 0, 1000 × 2 mm, a miss
    assert first[100:104].hex() == "ffee" + "2800"  # 0.40 degrees on
    assert first[1200:].hex() == "90d00300" + "3722"  # 250,000 µs past the hour, strongest return, VLP-16


def test_packets_follow_each_other_as_the_sensor_sends_them() -> None:
    packets = np.frombuffer(b"".join(encode_scan(wall())), PACKET)
    assert np.diff(packets["time"].astype(int)).tolist() == pytest.approx([1327] * 75, abs=1)
    turned = np.diff(np.unwrap(packets["blocks"]["azimuth"].ravel() / 100.0, period=360))
    assert np.abs(turned - 0.3981).max() < 0.011
    empty = packets["blocks"]["returns"]["distance"].reshape(-1, 32)[904:]
    assert len(empty) == 8 and not empty.any()
    assert FIRING_TIMES[-1] < 76 * 0.001328


def test_what_the_sensor_cannot_say_is_a_miss() -> None:
    scan = wall()
    scan[:6] = [[np.inf, 0, 0], [0, 0, 0], [np.nan] * 3, [131.2, 0, 0], [1e30, 0, 0], [0.04, 0, 0]]
    assert len(decode_vlp16(encode_scan(scan))) == 28928 - 6


def test_a_cloud_that_is_no_scan_is_refused() -> None:
    with pytest.raises(UavrlError, match=r"28928 points \[P, 3\] in firing order.*got \[5, 3\]"):
        encode_scan(np.zeros((5, 3)))


def test_the_plain_decoder_gives_what_the_library_gives() -> None:
    library = make_decoder("VLP16")
    rng = np.random.default_rng(0)
    packets = np.frombuffer(b"".join(encode_scan(wall())), PACKET).copy()
    packets["blocks"]["returns"]["distance"] = rng.integers(26, 2**16, (76, 12, 32))
    listed = [packet.tobytes() for packet in packets]
    ours, theirs = decode_vlp16(listed), library(listed)
    assert ours.shape == theirs.shape
    ranges = np.linalg.norm(theirs, axis=1)
    np.testing.assert_allclose(np.linalg.norm(ours, axis=1), ranges, rtol=1e-6)
    assert (np.linalg.norm(ours - theirs, axis=1) / ranges).max() < np.radians(0.006)  # it rounds to 0.01 degrees


def test_scans_one_after_the_other_come_back_each_as_itself() -> None:
    assembler = ScanAssembler("VLP16")
    found = []
    for number, distance in enumerate((2.0, 3.0, 4.0)):
        packets = encode_scan(wall(distance), stamp=0.1 * number)
        found += [assembler.push(0.1 * number + 1e-3 * n, packet) for n, packet in enumerate(packets)]
    scans = [scan for scan in found if scan is not None]
    assert [round(float(np.linalg.norm(scan.points, axis=1).mean()), 3) for scan in scans] == [2.0, 3.0, 4.0]
    assert [scan.stamp for scan in scans] == pytest.approx([0.075, 0.175, 0.275])
    assert assembler.skipped.sentences() == []


def test_a_stream_is_the_packets_of_a_sensor_that_turns_on() -> None:
    turns, parts, whole = [wall(1.0 + turn) for turn in range(4)], PacketStream(), PacketStream()
    cut = [0, 7 * 32, 8 * 32, 500 * 32, len(wall())]
    sent = [
        packet
        for number, points in enumerate(turns)
        for first, last in pairwise(cut)
        for packet in parts.add(points[first:last], first, 0.1 * number)
    ]
    assert sent == [packet for number, points in enumerate(turns) for packet in whole.add(points, 0, 0.1 * number)]
    times, packets = zip(*sent, strict=True)
    assert len(packets) == 4 * 904 // 12 and np.diff(times) == pytest.approx([0.00132710] * 300, abs=3e-5)
    assert times[0] == pytest.approx(24 * 55.296e-6)
    assert np.linalg.norm(decode_vlp16([packets[75]]), axis=1).round(2).tolist() == [1.0] * 128 + [2.0] * 256
    assembler = ScanAssembler("VLP16")
    scans = [scan for at, packet in sent if (scan := assembler.push(at, packet))]
    assert len(scans) == 3 and not assembler.skipped.sentences()
    assert {scan.rays for scan in scans} <= {76 * 384, 77 * 384}
