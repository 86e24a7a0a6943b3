"""Packets of an Ouster to scans: what the sensor sends, and what a network, a wrong file or a stranger may send."""

from __future__ import annotations

import json
import socket
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.helpers.ouster import (
    BEAMS,
    COLUMNS,
    DUAL,
    PACKETS,
    SERIAL,
    SINGLE,
    metadata_of,
    need_sdk,
    points_of,
    turn,
    write_metadata,
)
from tests.helpers.ports import free_ports

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.assemblers import make_assembler
from uavrl_onboard.lidar.ouster import OusterAssembler
from uavrl_onboard.lidar.ouster_metadata import read_metadata
from uavrl_onboard.lidar.pcap import write_pcap
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.lidar.udp_scans import UdpScans

need_sdk()

RANGES = np.random.default_rng(3).integers(300, 90_000, (2, BEAMS, COLUMNS)).astype(np.uint32)
RANGES[0, :, 40:60] = 0
RANGES[1, :, 50:90] = 0


def pushed(assembler: OusterAssembler, packets: list[bytes]) -> list[Scan]:
    found = [assembler.push(0.003 * n, packet) for n, packet in enumerate(packets)]
    return [scan for scan in found if scan is not None]


@pytest.fixture
def assembler(tmp_path: Path) -> OusterAssembler:
    return OusterAssembler(write_metadata(tmp_path))


def far(scan: Scan) -> np.ndarray:
    return np.sqrt((scan.points.astype(float) ** 2).sum(-1))


def test_a_turn_is_a_scan_with_the_points_of_the_manual_s_formula(assembler: OusterAssembler) -> None:
    found = pushed(assembler, turn(RANGES, 1) + turn(RANGES, 2))
    assert len(found) == 2 and found[0].stamp == pytest.approx(31 * 0.003), "it ends with its own last packet"
    hit = RANGES[0] > 0
    assert found[0].points.dtype == np.float32 and found[0].packets == PACKETS
    np.testing.assert_allclose(found[0].points, points_of(RANGES[0])[hit], atol=2e-5)
    assert (found[0].rays, found[0].misses) == (BEAMS * COLUMNS, int((~hit).sum()))
    assert assembler.skipped.sentences() == []


def test_x_is_ahead_y_left_and_z_up(assembler: OusterAssembler) -> None:
    """The sensor turns clockwise from its connector, which looks back."""
    ranges = np.zeros((BEAMS, COLUMNS), np.uint32)
    ranges[16, COLUMNS // 2] = 5000  # half a turn after the connector
    ranges[0, COLUMNS // 4] = 7000  # a quarter after it
    (scan,) = pushed(assembler, turn(ranges))
    left, ahead = scan.points
    assert ahead == pytest.approx([5.0, 0.0, 0.0], abs=0.4) and left == pytest.approx([0.0, 6.5, 2.5], abs=0.6)


def test_of_two_returns_both_are_points(tmp_path: Path) -> None:
    assembler = OusterAssembler(write_metadata(tmp_path, metadata_of(DUAL)))
    (scan,) = pushed(assembler, turn(RANGES, 1, DUAL))
    hit = RANGES > 0
    both = np.concatenate([points_of(each)[seen] for each, seen in zip(RANGES, hit, strict=True)])
    np.testing.assert_allclose(scan.points, both, atol=2e-5)
    assert scan.misses == int((~hit.any(0)).sum()) and scan.rays == BEAMS * COLUMNS


@pytest.mark.parametrize("profile", ["LEGACY", "RNG15_RFL8_NIR8", "FUSA_RNG15_RFL8_NIR8_DUAL", SINGLE, DUAL])
def test_packets_that_the_sdk_writes_give_the_points_of_the_sdk(profile: str, tmp_path: Path) -> None:
    from ouster.sdk import core

    path = write_metadata(tmp_path, metadata_of(profile))
    info = core.SensorInfo(path.read_text())
    frame = core.LidarFrame(info)
    frame.frame_id = 3
    frame.status[:], frame.measurement_id[:] = 1, np.arange(COLUMNS)
    frame.timestamp[:] = np.arange(COLUMNS) * 195_312 + 1
    frame.packet_timestamp[:], frame.alert_flags[:] = 1, 0
    frame.field("RANGE")[:] = RANGES[0] // 8 * 8  # what the profiles of 15 bits can say
    if "DUAL" in profile:
        frame.field("RANGE2")[:] = 0
    packets = core.frame_to_packets(frame, core.PacketFormat(info), 7, SERIAL)
    (scan,) = pushed(OusterAssembler(path), [bytes(each.buf) for each in packets if isinstance(each, core.LidarPacket)])
    expected = core.XYZLut(info, False)(frame.field("RANGE"))[RANGES[0] // 8 > 0] - [0, 0, 0.03618]
    np.testing.assert_allclose(scan.points, expected, atol=2e-5)


def test_lost_packets_are_counted_and_a_wide_gap_leaves_the_turn_out(assembler: OusterAssembler) -> None:
    first, second, third = turn(3000, 1), turn(3000, 2), turn(3000, 3)
    found = pushed(assembler, first + second[:10] + second[12:] + third)  # two packets are 22 degrees
    assert [scan.packets for scan in found] == [32, 30, 32] and assembler.skipped.lost == 2
    found = pushed(assembler, turn(3000, 4)[:10] + turn(3000, 4)[13:] + turn(3000, 5))  # three are 34
    assert [scan.packets for scan in found] == [32]
    assert assembler.skipped.lost == 5 and assembler.skipped.incomplete == 1
    found = pushed(assembler, turn(3000, 6)[2:] + turn(3000, 7)[:-2] + turn(3000, 8))
    assert [scan.packets for scan in found] == [30, 30, 32], "the gap reaches over the end of the turn"


def test_turns_that_never_came_are_lost_packets(assembler: OusterAssembler) -> None:
    assert len(pushed(assembler, turn(3000, 1) + turn(3000, 4))) == 2
    assert assembler.skipped.lost == 2 * PACKETS


def test_listening_begins_anywhere(assembler: OusterAssembler) -> None:
    found = pushed(assembler, turn(3000, 1)[20:] + turn(3000, 2))
    assert len(found) == 1 and assembler.skipped.sentences() == []
    found = pushed(OusterAssembler(assembler.metadata), turn(3000, 1)[2:] + turn(3000, 2))
    assert [scan.packets for scan in found] == [30, 32]


def test_packets_come_late_twice_and_over_the_end_of_the_numbers(assembler: OusterAssembler) -> None:
    one, two = turn(RANGES, 2**16 - 1, clock=1.0), turn(RANGES, 2**16, clock=1.1)
    swapped = [*one[:5], one[6], one[5], one[5], *one[7:]]
    found = pushed(assembler, swapped + two + one[-1:])
    assert [scan.packets for scan in found] == [32, 32]
    np.testing.assert_array_equal(found[0].points, found[1].points)
    assert assembler.skipped.sentences() == ["1 packet out of order"]


def test_a_packet_of_the_next_turn_ends_one_that_lacks_its_last(assembler: OusterAssembler) -> None:
    one, two = turn(3000, 1), turn(3000, 2)
    found = pushed(assembler, one[:-1] + two[:1] + one[-1:] + two[1:])
    assert [scan.packets for scan in found] == [31, 32]
    assert assembler.skipped.sentences() == ["1 packet out of order"]


def test_a_sensor_that_starts_anew_and_a_capture_that_repeats_are_read_on(assembler: OusterAssembler) -> None:
    assert len(pushed(assembler, turn(3000, 900) + turn(3000, 5) + turn(3000, 6))) == 3
    loop = [packet for _ in range(4) for n in (7, 8, 9) for packet in turn(3000, n)]
    assert len(pushed(assembler, loop)) >= 3 + 3 * 1
    assert assembler.skipped.incomplete == 0


def test_a_slow_turn_is_left_out(assembler: OusterAssembler) -> None:
    slow = turn(3000, 1, clock=1.0)[:16] + turn(3000, 1, clock=1.4)[16:]
    assert len(pushed(assembler, slow + turn(3000, 2, clock=1.6))) == 1
    assert assembler.skipped.sentences() == ["1 turn with a gap or without an end"]


def test_what_was_seen_before_a_silence_is_not_given_out_after_it(assembler: OusterAssembler) -> None:
    """The stamp of a scan is that of its last packet: an old turn would pass for a new one."""
    before, after = turn(3000, 1, clock=1.0)[:-1], turn(9000, 10, clock=1.9)
    assert pushed(assembler, [*before, after[0]]) == [] and assembler.skipped.incomplete == 1
    (scan,) = pushed(assembler, after[1:])
    assert np.linalg.norm(scan.points, axis=-1).min() > 8.9


def test_what_is_no_lidar_packet_is_counted(assembler: OusterAssembler) -> None:
    clean = turn(3000, 1)
    other_type = b"\x02" + clean[0][1:]
    beyond = bytearray(clean[1])
    beyond[40:42] = COLUMNS.to_bytes(2, "little")  # a column that the metadata does not have
    invalid = bytearray(clean[2])
    for start in range(32 + 10, len(invalid) - 32, 12 + 12 * BEAMS):
        invalid[start : start + 2] = bytes(2)
    others = [b"", bytes(48), clean[0][:-1], clean[0] + b"\0", other_type, bytes(beyond), bytes(invalid), bytes(1206)]
    found = pushed(assembler, others + [each for packet in clean for each in (packet, bytes(48))])
    assert len(found) == 1 and found[0].packets == 32
    counts = assembler.skipped
    assert (counts.imu, counts.other_size, counts.damaged) == (33, 4, 2)


def test_packets_of_another_sensor_are_left_out_and_named(assembler: OusterAssembler) -> None:
    assert not pushed(assembler, turn(3000, 1, serial=SERIAL + 1))
    assert assembler.skipped.other_serial == 32
    assert assembler.trouble() == (
        f"its packets come from the sensor with the serial number {SERIAL + 1}, and {assembler.metadata} is of "
        f"{SERIAL}: give the metadata of the sensor that sent them."
    )


def test_random_packets_harm_nothing(assembler: OusterAssembler) -> None:
    rng = np.random.default_rng(5)
    clean = [packet for n in range(3) for packet in turn(RANGES, n)]
    for packet in clean:
        content = np.frombuffer(packet, np.uint8).copy()
        content[rng.integers(0, 60, 6)] = rng.integers(0, 256, 6)
        assembler.push(0.0, content.tobytes())
        assembler.push(0.0, packet[:4] + rng.bytes(len(packet) - 4))
        assembler.push(0.0, rng.bytes(len(packet)))
    assert len(pushed(assembler, turn(3000, 500) + turn(3000, 501))) >= 1, "and the next turns are read"


def test_memory_stays_bounded(assembler: OusterAssembler) -> None:
    packets = [packet for n in range(6) for packet in turn(3000, n)]
    pushed(assembler, packets)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(5):
        pushed(assembler, packets)
    assert tracemalloc.get_traced_memory()[0] - before < 1e5
    tracemalloc.stop()


# ---------------------------------------------------------------------- metadata


def changed(section: str, name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(told: dict[str, Any]) -> None:
        told[section][name] = value

    return change


def with_angles(value: float) -> Callable[[dict[str, Any]], None]:
    return changed("beam_intrinsics", "beam_altitude_angles", [value] * BEAMS)


BAD = {
    "a frame of 2^31 columns": (changed("lidar_data_format", "columns_per_frame", 2**31), "must be in"),
    "2^32 beams": (changed("lidar_data_format", "pixels_per_column", 2**32 - 1), "must be in"),
    "no column in a packet": (changed("lidar_data_format", "columns_per_packet", 0), "must be in"),
    "columns in words": (changed("lidar_data_format", "columns_per_frame", "many"), "must be in"),
    "too few angles": (changed("beam_intrinsics", "beam_azimuth_angles", [0.0, 1.0]), "elements"),
    "no angles": (changed("beam_intrinsics", "beam_altitude_angles", []), "empty"),
    "angles that are no numbers": (with_angles(float("nan")), "not JSON compliant"),
    "a transform that stretches": (
        changed("lidar_intrinsics", "lidar_to_sensor_transform", (2 * np.eye(4)).ravel().tolist()),
        "describe no beams",
    ),
    "beams far from the sensor": (
        changed("beam_intrinsics", "lidar_origin_to_beam_origin_mm", 1e9),
        "describe no beams",
    ),
    "an unknown profile": (changed("lidar_data_format", "udp_profile_lidar", "OFF"), "hold no ranges"),
    "a section that is a list": (lambda told: told.update(lidar_data_format=[1]), "cannot|no attribute"),
}


@pytest.mark.parametrize("name", BAD)
def test_metadata_that_are_none_are_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    change, reason = BAD[name]
    told = metadata_of()
    change(told)
    path = write_metadata(tmp_path, told)
    with pytest.raises(UavrlError, match=rf"{path} is no metadata of an Ouster .*{reason}.*: save the sensor's own"):
        read_metadata(path)


@pytest.mark.parametrize(
    "content",
    [b"", b"{}", b"[1]", b"\xff\xfe", b"[" * 100_000, b'{"a": ' * 100_000, b"1" * 10_000, b" " * (2**20 + 1)],
    ids=["empty", "no names", "a list", "no text", "deep list", "deep names", "a long number", "large"],
)
def test_a_file_that_is_no_metadata_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(UavrlError, match=r"is no metadata of an Ouster that can be read"):
        read_metadata(path)
    with pytest.raises(UavrlError, match=r"The metadata .*b\.json cannot be read \(No such file"):
        read_metadata(tmp_path / "b.json")


def test_archives_and_texts_in_metadata_are_not_read(tmp_path: Path) -> None:
    told = metadata_of() | {"zone_set": "UEsDBBQ" * 1000, "user_data": "x" * 100_000}
    assert read_metadata(write_metadata(tmp_path, told)).name == "OS-1-32"


def test_a_narrow_azimuth_window_is_refused_and_a_wide_one_is_whole(tmp_path: Path) -> None:
    path = write_metadata(tmp_path, metadata_of(column_window=[100, 400]))
    with pytest.raises(UavrlError, match=r"covers only 212°, .* set the sensor.s azimuth_window to \[0, 36"):
        read_metadata(path)
    wide = OusterAssembler(write_metadata(tmp_path, metadata_of(column_window=[480, 447])))  # all but 32 columns
    packets = turn(3000, 1)
    found = pushed(wide, packets[:28] + packets[30:])
    assert [scan.packets for scan in found] == [30] and wide.skipped.sentences() == []


def test_model_and_metadata_exclude_each_other(tmp_path: Path) -> None:
    with pytest.raises(UavrlError, match="drop metadata, or drop model and product"):
        make_assembler("VLP16", None, write_metadata(tmp_path))
    with pytest.raises(UavrlError, match="or give metadata=FILE for an Ouster"):
        make_assembler("OS1")


def test_without_ouster_sdk_its_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uavrl_onboard.lidar import ouster_metadata

    ouster_metadata.sdk.cache_clear()
    monkeypatch.setitem(sys.modules, "ouster.sdk.core", None)
    with pytest.raises(UavrlError, match=r"Reading the packets of an Ouster needs ouster.*onboard\[ouster\]"):
        read_metadata(write_metadata(tmp_path))
    ouster_metadata.sdk.cache_clear()


# ---------------------------------------------------------------------- sources


def test_a_capture_is_read_with_its_metadata(tmp_path: Path) -> None:
    packets = [packet for n in range(3) for packet in turn(RANGES, n)]
    write_pcap(tmp_path / "a.pcap", [(5 + 0.003125 * n, packet) for n, packet in enumerate(packets)], port=7502)
    path = write_metadata(tmp_path)
    source = ScanSource(tmp_path / "a.pcap", metadata=path)
    scans = list(source)
    assert len(scans) == 3 and source.remarks() == []
    assert np.diff([scan.stamp for scan in scans]) == pytest.approx([0.1, 0.1], abs=1e-4)
    with pytest.raises(UavrlError, match=r"gave no scan: it holds no full turn of an OS-1-32 \(96 packets of a"):
        list(ScanSource(tmp_path / "a.pcap", metadata=write_metadata(tmp_path, metadata_of(DUAL), "other.json")))
    with pytest.raises(UavrlError, match=r"gave no scan: it holds no full turn of a VLP16 \(96 packets of another si"):
        list(ScanSource(tmp_path / "a.pcap", "VLP16"))


def test_a_recording_of_ouster_s_own_kind_says_how_to_make_a_capture(tmp_path: Path) -> None:
    (tmp_path / "a.osf").write_bytes(bytes.fromhex("34000000140000004f5346240c002000"))
    with pytest.raises(UavrlError, match=r"\(OSF\): .* with ouster-cli source .*a\.osf save a\.pcap"):
        ScanSource(tmp_path / "a.osf", metadata=tmp_path / "a.json")


def test_of_two_sensors_on_one_port_one_is_read(tmp_path: Path) -> None:
    port, _ = free_ports()
    feed = UdpScans(f"udp://127.0.0.1:{port}", None, metadata=str(write_metadata(tmp_path)))
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        scans = []
        for near, far_off in zip(turn(3000, 1), turn(9000, 1), strict=True):
            ours.sendto(near, ("127.0.0.1", port))
            other.sendto(far_off, ("127.0.0.1", port))
            scans.append(feed.poll(time.monotonic()))
        (scan,) = [each for each in scans if each is not None]
        assert far(scan).max() == pytest.approx(3.0, abs=0.03)
        assert feed.skipped.other_sender == 32 and feed.remarks()[0].startswith("Two senders: only 127.0.0.1:")
        assert 0 <= time.monotonic() - scan.stamp < 5
    feed.close()


def test_the_port_is_the_one_of_the_metadata(tmp_path: Path) -> None:
    port, _ = free_ports()
    told = metadata_of()
    told["config_params"]["udp_port_lidar"] = port
    feed = UdpScans("udp://127.0.0.1", None, metadata=str(write_metadata(tmp_path, told)))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        for packet in turn(3000, 1):
            sensor.sendto(packet, ("127.0.0.1", port))
        assert feed.poll(time.monotonic()) is not None
    feed.close()


def test_metadata_of_old_firmware_are_read(tmp_path: Path) -> None:
    """Firmware before 2.3 gave one list of names."""
    told = metadata_of()
    flat = told["beam_intrinsics"] | told["sensor_info"] | told["imu_intrinsics"] | told["lidar_intrinsics"]
    flat |= {"data_format": told["lidar_data_format"], "lidar_mode": "512x10", "udp_port_lidar": 7502}
    path = tmp_path / "flat.json"
    path.write_text(json.dumps(flat))
    assert len(pushed(OusterAssembler(path), turn(3000, 1))) == 1
