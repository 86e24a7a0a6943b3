"""Packets to scans: what a real network, a wrong sensor or a stranger may send."""

from __future__ import annotations

import sys
import tracemalloc

import numpy as np
import pytest
from tests.helpers.packets import turns

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.packets import PACKET, PRODUCTS, encode_scan
from uavrl_onboard.lidar.scans import Scan, ScanAssembler
from uavrl_onboard.lidar.vlp16 import firing_directions


def pushed(packets: list[bytes], model: str = "VLP16", product: int | None = None) -> tuple[list[Scan], ScanAssembler]:
    assembler = ScanAssembler(model, product)
    found = [assembler.push(0.001327 * n, packet) for n, packet in enumerate(packets)]
    return [scan for scan in found if scan is not None], assembler


def test_each_scan_is_a_whole_turn_wherever_it_began() -> None:
    found, assembler = pushed(turns(4)[10:])
    assert len(found) == 3 and {len(scan.points) for scan in found} == {76 * 384}
    for scan in found:
        azimuth = np.sort(np.degrees(np.arctan2(scan.points[:, 1], scan.points[:, 0])) % 360)
        assert np.diff(azimuth, append=azimuth[0] + 360).max() < 0.45
    assert assembler.skipped.sentences() == []
    stamp, points = found[0]
    assert stamp == found[0].stamp and points is found[0].points


def test_the_model_is_named_and_never_guessed() -> None:
    for name in (None, "vlp16", "VLP-16", "HDL64E"):
        with pytest.raises(UavrlError, match=r"model must be one of VLP16, PuckHiRes, .* is not guessed"):
            ScanAssembler(name)  # type: ignore[arg-type]


def test_turns_that_were_sent_one_by_one_overlap_and_have_no_gap() -> None:
    packets = [packet for turn in range(4) for packet in encode_scan(3.0 * firing_directions(), stamp=1.0 + 0.1 * turn)]
    for begin in (0, 1, 40, 75):
        found, assembler = pushed(packets[begin:])
        assert len(found) == (4 if begin == 0 else 3), begin
        assert {scan.rays for scan in found} <= {75 * 384, 76 * 384, 77 * 384}
        assert assembler.skipped.sentences() == []


def test_packets_of_another_model_are_left_out_and_their_byte_is_told() -> None:
    other = [packet[:-1] + b"\x21" for packet in turns(2)]
    found, assembler = pushed(other)
    assert not found and assembler.skipped.other_product == len(other)
    assert "product byte 33 (0x21), and a VLP16 has 34" in assembler.trouble()
    assert "give product=33" in assembler.trouble()
    allowed, _ = pushed(other, product=0x21)
    assert len(allowed) == 2
    _, assembler = pushed(turns(2), product=0x21)
    assert assembler.trouble() == "its packets carry the product byte 34 (0x22), not the 33 of product=33."


@pytest.mark.parametrize("model", PRODUCTS)
def test_every_model_that_is_named_is_decoded(model: str) -> None:
    byte = bytes([PRODUCTS[model]])
    found, assembler = pushed([packet[:-1] + byte for packet in turns(3)], model)
    assert found and all(np.isfinite(scan.points).all() and len(scan.points) > 1000 for scan in found)
    assert not assembler.skipped.other_product


def test_what_is_no_data_packet_is_counted() -> None:
    packets = turns(2)
    rng = np.random.default_rng(0)
    others = [packets[0][:500], b"", rng.bytes(1206), packets[0] + b"\0", bytes(512), packets[0][:-2] + b"\x55\x22"]
    others.append(packets[0][:2] + b"\xff\xff" + packets[0][4:])  # an azimuth of 655 degrees
    mixed = [each for n, packet in enumerate(packets) for each in (packet, others[n % len(others)])]
    found, assembler = pushed(mixed)
    clean, _ = pushed(packets)
    assert len(found) == len(clean) == 2
    for scan, expected in zip(found, clean, strict=True):
        np.testing.assert_array_equal(scan.points, expected.points)
    skipped = assembler.skipped
    assert (skipped.position > 15, skipped.other_size > 60, skipped.damaged > 60) == (True, True, True)
    assert skipped.position + skipped.other_size + skipped.damaged == len(packets)


def test_of_two_returns_of_a_ray_one_is_enough() -> None:
    packets = np.frombuffer(b"".join(turns(4)), PACKET).copy()
    packets["mode"], packets["time"] = 0x39, np.arange(packets.size) * 663.552
    packets["blocks"]["azimuth"] = (np.arange(packets.size * 12) // 2 * 39.8131 % 36000).reshape(-1, 12)
    distances = packets["blocks"]["returns"]["distance"]
    distances[:, 0::2, 0] = 0  # the last return of the first laser is missing, not its strongest
    distances[:, :, 1] = 0  # the second laser hits nothing
    distances[:, 1::2, 2:] += 500  # all others have two returns 1 m apart
    found, assembler = pushed([packet.tobytes() for packet in packets])
    assert len(found) == 2 and assembler.skipped.sentences() == []
    for scan in found:
        assert (scan.rays, scan.misses) == (151 * 192, 151 * 6)
        assert len(scan.points) == 151 * 6 * (1 + 2 * 30)


def test_lost_packets_leave_gaps_and_are_counted() -> None:
    packets, rng = turns(10), np.random.default_rng(1)
    kept = [packet for packet in packets if rng.random() > 0.1]
    found, assembler = pushed(kept)
    assert len(found) in (9, 10)
    assert assembler.skipped.lost == pytest.approx(len(packets) - len(kept), abs=3)
    assert all(60 * 384 < len(scan.points) < 78 * 384 for scan in found)


def test_packets_out_of_order_stay_in_their_turn() -> None:
    packets = turns(5)
    swapped = packets.copy()
    for n in range(7, len(packets) - 2, 19):
        swapped[n], swapped[n + 2] = packets[n + 2], packets[n]
    found, assembler = pushed(swapped)
    clean, _ = pushed(packets)
    assert [len(scan.points) for scan in found] == pytest.approx([len(scan.points) for scan in clean], abs=2 * 384)
    assert len(found) == len(clean) and assembler.skipped.late > 0
    assert assembler.skipped.lost <= assembler.skipped.late


def test_a_sensor_at_20_hz_gives_twice_as_many_scans() -> None:
    packets = np.frombuffer(b"".join(turns(6)), PACKET).copy()
    packets["blocks"]["azimuth"] = (np.arange(packets.size * 12) * 79.6262 % 36000).reshape(-1, 12)
    found, assembler = pushed([packet.tobytes() for packet in packets])
    assert len(found) == 12 and {len(scan.points) for scan in found} <= {37 * 384, 38 * 384, 39 * 384}
    assert assembler.skipped.sentences() == []


def test_a_turn_with_a_gap_is_left_out_and_the_next_one_is_whole() -> None:
    packets = [*turns(2)[:100], *turns(2, 4.0, stamp=1.0)]
    found, assembler = pushed(packets)
    ranges = [np.linalg.norm(scan.points, axis=1) for scan in found]
    assert [round(float(each.min()), 2) for each in ranges] == [round(float(each.max()), 2) for each in ranges]
    assert [round(float(each.min()), 2) for each in ranges] == [3.0, 4.0, 4.0]
    assert assembler.skipped.incomplete == 1


def test_a_sensor_that_stands_still_gives_no_scan_and_takes_no_memory() -> None:
    packets = np.frombuffer(b"".join(turns(20)), PACKET).copy()
    packets["blocks"]["azimuth"] = 1234
    found, assembler = pushed([packet.tobytes() for packet in packets])
    assert not found and assembler.skipped.incomplete >= 5
    packets["time"] = 7
    found, assembler = pushed([packet.tobytes() for packet in packets] * 3)
    assert not found and assembler.skipped.incomplete >= 1


def test_the_hour_may_end_in_a_turn() -> None:
    found, assembler = pushed(turns(4, stamp=3600.0 - 0.15))
    assert len(found) == 4 and assembler.skipped.sentences() == []


def test_a_last_turn_that_lacks_less_than_a_packet_counts() -> None:
    packets = turns(1)
    _, assembler = pushed(packets[:75])
    last = assembler.finish(1.0)
    assert last is not None and last.rays == 75 * 384
    _, assembler = pushed(packets[:40])
    assert assembler.finish(1.0) is None and "no full turn of a VLP16" in assembler.trouble()


def test_without_the_library_single_returns_are_read_and_dual_ones_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with_library, _ = pushed(turns(2))
    monkeypatch.setitem(sys.modules, "velodyne_decoder", None)
    found, _ = pushed(turns(2))
    assert len(found) == len(with_library)
    np.testing.assert_allclose(found[0].points, with_library[0].points, atol=3 * np.radians(0.0125))
    _, assembler = pushed([packet[:-2] + b"\x39\x22" for packet in turns(2)])
    assert assembler.skipped.dual == 152 and "pip install 'uavrl-onboard[lidar]'" in assembler.trouble()
    with pytest.raises(
        UavrlError,
        match=r"Decoding the packets of a HDL32E needs velodyne-decoder: pip install 'uavrl-onboard\[lidar\]'",
    ):
        ScanAssembler("HDL32E")


def test_random_bytes_change_nothing_and_take_no_memory() -> None:
    assembler, rng = ScanAssembler("VLP16"), np.random.default_rng(2)
    begins = np.frombuffer(turns(1)[0], np.uint8)
    tracemalloc.start()
    try:
        for n in range(3000):
            packet = begins.copy()
            packet[rng.integers(0, 1206, 40)] = rng.integers(0, 256, 40)
            assembler.push(0.1 * n, packet.tobytes() if n % 2 else rng.bytes(int(rng.integers(0, 2000))))
            if n == 300:
                before = tracemalloc.get_traced_memory()[0]
        assert tracemalloc.get_traced_memory()[0] - before < 6_000_000  # an open turn holds 4,096 packets at most
    finally:
        tracemalloc.stop()


def test_half_a_turn_is_no_scan_and_a_small_gap_is_one() -> None:
    """What no packet tells of would look free to a policy."""
    packets = turns(6)
    for end, whole in ((105, 6), (138, 5), (214, 4)):
        found, assembler = pushed(packets[:100] + packets[end:])
        assert len(found) == whole and assembler.skipped.lost == end - 100
        assert assembler.skipped.incomplete == (end > 105)
    ahead = [packet for packet in packets if int.from_bytes(packet[2:4], "little") < 18_000]  # a setting of the sensor
    found, assembler = pushed(ahead)
    assert found == [] and "5 turns with a gap" in assembler.trouble()


def test_packets_that_come_twice_count_once() -> None:
    found, _ = pushed([packet for each in turns(2) for packet in (each, each)])
    assert [scan.rays for scan in found] == [76 * 384] * 2
