"""Every source gives the same scans."""

from __future__ import annotations

import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.helpers.captures import KINDS, PACKETS, TIMES, captured
from tests.helpers.recordings import CLOUD, SCAN, cloud_message, scan_message, store, write_bag

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import is_return
from uavrl_onboard.lidar import bags, sources
from uavrl_onboard.lidar.packets import encode_scan
from uavrl_onboard.lidar.pcap import read_datagrams, write_pcap
from uavrl_onboard.lidar.sources import ScanSource, without_vehicle
from uavrl_onboard.lidar.udp import address, read_udp
from uavrl_onboard.lidar.vlp16 import firing_directions

POINTS = np.array([[1.0, 2.0, 3.0], [np.nan] * 3, [0.0, 0.0, 0.0], [-4.0, 5.5, 6.0]], np.float32)


@pytest.mark.parametrize("kind", KINDS)
def test_all_kinds_of_files_give_the_same_scans(kind: str, tmp_path: Path) -> None:
    path = KINDS[kind](tmp_path)
    inner = [path] if path.is_file() else [path, *(p for p in path.iterdir() if p.suffix in (".db3", ".mcap"))]
    for each in inner:
        source = ScanSource(each, "VLP16")
        scans = list(source)
        assert [scan.points.shape for scan in scans] == [(76 * 384, 3)] * 3
        assert all(scan.points.dtype == np.float32 for scan in scans)
        assert np.diff([scan.stamp for scan in scans]) == pytest.approx(76 * 0.001327, abs=1e-4)
        assert kind == "bin" or scans[0].stamp == pytest.approx(TIMES[75], abs=1e-4)
        assert source.skipped.sentences() == [] and len(list(source)) == 3, "it can be read again"


@pytest.mark.parametrize("kind", ["ros1", "db3", "mcap"])
def test_a_driver_s_clouds_come_as_they_are(kind: str, tmp_path: Path) -> None:
    types = store(kind == "ros1")
    forms: list[dict[str, Any]] = [{}, {"big": True}, {"double": True, "pad": 0}]
    messages = [cloud_message(types, POINTS, 5.0 + n, **form) for n, form in enumerate(forms)]
    path = write_bag(tmp_path / "a.bag", kind, {"/points": (CLOUD, messages)})
    scans = list(ScanSource(path))
    assert [scan.stamp for scan in scans] == [5.0, 6.0, 7.0] and {(scan.rays, scan.misses) for scan in scans} == {
        (4, 2)
    }
    for scan in scans:
        np.testing.assert_array_equal(scan.points, POINTS)
        assert is_return(scan.points).tolist() == [True, False, False, True]


def test_of_several_topics_one_is_named(tmp_path: Path) -> None:
    types = store()
    topics = {"/a": (CLOUD, [cloud_message(types, POINTS)]), "/b": (SCAN, [scan_message(types, PACKETS[:76])])}
    path = write_bag(tmp_path / "a", "db3", topics)
    with pytest.raises(UavrlError, match=r"more than one with scans: give topic=NAME, one of /a, /b"):
        ScanSource(path, "VLP16")
    assert len(list(ScanSource(path, topic="/a"))) == 1
    assert len(list(ScanSource(path, "VLP16", topic="/b"))) == 1
    with pytest.raises(UavrlError, match=r"no /c with scans"):
        ScanSource(path, "VLP16", topic="/c")
    with pytest.raises(UavrlError, match="model must be one of VLP16"):
        ScanSource(path, topic="/b")


@pytest.mark.parametrize(
    "change",
    [{"fields": []}, {"point_step": 0}, {"point_step": 8}, {"row_step": 3}, {"height": 9}, {"width": 2**31}],
    ids=str,
)
def test_a_cloud_whose_fields_do_not_fit_its_data_is_counted(change: dict[str, Any], tmp_path: Path) -> None:
    message = cloud_message(store(), POINTS)
    for name, value in change.items():
        setattr(message, name, value)
    assert bags.cloud_points(message) is None
    path = write_bag(tmp_path / "a", "db3", {"/a": (CLOUD, [message, cloud_message(store(), POINTS)])})
    source = ScanSource(path)
    assert len(list(source)) == 1 and source.skipped.malformed == 1


def test_a_sensor_is_heard_by_udp() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = ScanSource(f"udp://127.0.0.1:{port}", "VLP16", seconds=20.0)

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
            for _ in range(200):
                for packet in PACKETS:
                    sensor.sendto(packet, ("127.0.0.1", port))
                    sensor.sendto(bytes(512), ("127.0.0.1", port))
                if done.wait(0.02):
                    return

    done = threading.Event()
    sending = threading.Thread(target=send)
    sending.start()
    try:
        scan = next(iter(source))
    finally:
        done.set()
        sending.join()
    assert len(scan.points) > 60 * 384 and 0 <= time.monotonic() - scan.stamp < 5
    assert source.skipped.position > 0


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the system does not say when a packet arrived")
def test_a_packet_that_waited_for_us_is_as_old_as_it_is() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.bind(("127.0.0.1", 0))
        port = sensor.getsockname()[1]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        threading.Timer(0.05, lambda: [sensor.sendto(b"%d" % n, ("127.0.0.1", port)) for n in range(3)]).start()
        packets = read_udp(f"udp://127.0.0.1:{port}", seconds=10.0)
        first, content, _ = next(packets)
        assert content == b"0" and 0 <= time.monotonic() - first < 5
        time.sleep(0.2)  # the policy takes its time
        now = time.monotonic()
        second, content, _ = next(packets)
    assert content == b"1" and now - second > 0.15


def test_silence_and_bad_addresses_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UavrlError, match=r"no packet arrived\. Set this computer's address"):
        list(ScanSource("udp://127.0.0.1:24680", "VLP16", seconds=0.0))
    for bad in ("udp://:0", "udp://:70000", "udp:2368", "udp://a:b", "udp://::1:2368"):
        with pytest.raises(UavrlError, match=r"udp://:PORT or udp://HOST:PORT"):
            ScanSource(bad, "VLP16")
    assert address("udp://") == ("", 2368)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(UavrlError, match="cannot be listened to"):
            list(ScanSource(f"udp://127.0.0.1:{taken.getsockname()[1]}", "VLP16"))


def test_a_box_masks_the_vehicle_wherever_its_sensor_is() -> None:
    leg, ahead = np.array([[0.3, 0.2, -0.4], [0.6, 0.0, 0.0]], np.float32)
    low, high = np.array([-0.5, -0.5, -0.3]), np.array([0.5, 0.5, 0.3])
    seen = np.stack([leg, ahead, np.full(3, np.nan, np.float32)])
    assert len(without_vehicle(seen, low, high)) == 3, "from the sensor the leg lies below the box"
    kept = without_vehicle(seen, low, high, sensor=np.array([0.0, 0.0, 0.2]))
    np.testing.assert_array_equal(kept, seen[1:])
    assert kept.dtype == np.float32


def test_a_long_file_takes_little_memory(tmp_path: Path) -> None:
    import tracemalloc

    def most(repeats: int) -> int:
        path = tmp_path / f"{repeats}.bin"
        path.write_bytes(b"".join(PACKETS) * repeats)
        tracemalloc.start()
        try:
            assert sum(1 for _ in ScanSource(path, "VLP16")) > 2 * repeats
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    most(1)  # which imports what is needed first
    assert most(20) < 1.3 * most(6)
    assert sources.PACKET_SIZE == 1206 and len(list(read_datagrams(captured(tmp_path)))) == len(PACKETS)


def test_clouds_that_are_not_in_a_sensor_s_frame_are_refused(tmp_path: Path) -> None:
    frames = {"world": (["/map", "/map"], "in the frame map, which is fixed to the world"),
              "changed": (["velodyne", "ouster"], "frame changed from velodyne to ouster")}  # fmt: skip
    for name, (ids, said) in frames.items():
        messages = [cloud_message(store(), POINTS, 5.0 + number) for number in range(2)]
        for message, frame_id in zip(messages, ids, strict=True):
            message.header.frame_id = frame_id
        path = write_bag(tmp_path / name, "db3", {"/a": (CLOUD, messages)})
        with pytest.raises(UavrlError, match=said):
            list(ScanSource(path))


def test_packets_alone_go_on_over_the_hour_at_which_the_sensor_counts_from_0(tmp_path: Path) -> None:
    points = 3.0 * firing_directions()
    turns = [encode_scan(points, 3599.0 + 0.1 * number) for number in range(20)]
    (tmp_path / "hour.bin").write_bytes(b"".join(packet for turn in turns for packet in turn))
    stamps = [scan.stamp for scan in ScanSource(tmp_path / "hour.bin", "VLP16")]
    assert len(stamps) == 20
    np.testing.assert_allclose(np.diff(stamps), 0.1, atol=2e-3)


def test_a_capture_without_times_has_scans_a_tenth_of_a_second_apart(tmp_path: Path) -> None:
    points = 3.0 * firing_directions()
    packets = [packet for number in range(5) for packet in encode_scan(points, 0.1 * number)]
    write_pcap(tmp_path / "none.pcap", [(0.0, packet) for packet in packets])
    write_pcap(tmp_path / "some.pcap", [(2.0 + 0.001 * number, packet) for number, packet in enumerate(packets)])
    source = ScanSource(tmp_path / "none.pcap", "VLP16")
    stamps = [scan.stamp for scan in source]
    np.testing.assert_allclose(stamps, [0.0, 0.1, 0.2, 0.3, 0.4])
    assert source.remarks() == ["the capture's clock stands still: 4 scans of it count as 0.1 s after the one before."]
    source = ScanSource(tmp_path / "some.pcap", "VLP16")
    assert np.ptp([scan.stamp for scan in source]) == pytest.approx(0.3, abs=0.01) and source.remarks() == []


def test_a_capture_in_whole_seconds_goes_forward(tmp_path: Path) -> None:
    turns = [encode_scan(3.0 * firing_directions(), 0.1 * number) for number in range(60)]
    packets = [(float(number // 20), packet) for number, turn in enumerate(turns) for packet in turn]
    write_pcap(tmp_path / "whole.pcap", packets)
    stamps = [scan.stamp for scan in ScanSource(tmp_path / "whole.pcap", "VLP16")]
    assert len(stamps) == 60 and (np.diff(stamps) > 0.0).all()


def test_two_scans_at_one_time_do_not_delay_those_of_a_faster_sensor_for_ever(tmp_path: Path) -> None:
    turns = [encode_scan(3.0 * firing_directions(), 0.1 * number) for number in range(20)]
    times = [0.05 * (number - (number == 5)) for number in range(20)]
    write_pcap(
        tmp_path / "two.pcap", [(time, packet) for time, turn in zip(times, turns, strict=True) for packet in turn]
    )
    stamps = [scan.stamp for scan in ScanSource(tmp_path / "two.pcap", "VLP16")]
    assert (np.diff(stamps) > 0.0).all()
    np.testing.assert_allclose(stamps[-10:], times[-10:], atol=1e-5)
