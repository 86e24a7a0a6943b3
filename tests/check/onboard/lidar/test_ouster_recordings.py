"""Captures of real Ousters, which lie outside the repository: docs/lidar.md says where they come from."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.folders import ROOT
from tests.helpers.ouster import need_sdk
from uavrl_onboard.lidar.coverage import Coverage
from uavrl_onboard.lidar.pcap import read_datagrams
from uavrl_onboard.lidar.sources import ScanSource

need_sdk()

FOLDER = Path(os.environ.get("UAVRL_RECORDINGS", ROOT.parent / "shared/data/vlp16")).parent / "ouster"
RECORDINGS = {
    "OS-0-32-U1_v2.2.0_1024x10.pcap": "OS-0-32-U1_v2.2.0_1024x10.json",  # two returns
    "OS-0-128-U1_v2.3.0_1024x10.pcap": "OS-0-128-U1_v2.3.0_1024x10.json",  # 15 bits of range
    "OS-1-32-G_v2.1.1_1024x10.pcap": "OS-1-32-G_v2.1.1_1024x10.json",  # legacy packets
    "OS-1-128_v2.3.0_1024x10_lb_n3.pcap": "OS-1-128_v2.3.0_1024x10.json",
    "OS-2-32-U0_v2.0.0_1024x10.pcap": "OS-2-32-U0_v2.0.0_1024x10.json",  # legacy packets
    "OS-2-128-U1_v2.3.0_1024x10.pcap": "OS-2-128-U1_v2.3.0_1024x10.json",
}


@pytest.fixture(params=RECORDINGS)
def recording(request: pytest.FixtureRequest) -> tuple[Path, Path]:
    path = FOLDER / request.param
    if not path.exists():
        pytest.skip(f"needs the recording {path}: set UAVRL_RECORDINGS=FOLDER, beside which it lies in ouster")
    return path, FOLDER / RECORDINGS[request.param]


def test_a_capture_gives_the_points_that_the_sdk_gives(recording: tuple[Path, Path]) -> None:
    from ouster.sdk import core

    path, metadata = recording
    source = ScanSource(path, metadata=metadata)
    scans = list(source)
    info = core.SensorInfo(metadata.read_text())
    form, batcher, frame = core.PacketFormat(info), core.FrameBatcher(info), core.LidarFrame(info)
    theirs = []
    for stamp, packet, _ in read_datagrams(path):
        if len(packet) == form.lidar_packet_size:
            each = core.LidarPacket(form)
            each.buf[:], each.host_timestamp = np.frombuffer(packet, np.uint8), int(stamp * 1e9)
            if batcher.batch(each, frame):
                lut = core.XYZLut(info, False)
                fields = [frame.field(name) for name in ("RANGE", "RANGE2") if frame.has_field(name)]
                theirs.append(np.concatenate([lut(field)[field > 0] for field in fields]))
    assert len(scans) == len(theirs) >= 1
    up = info.lidar_to_sensor_transform[:3, 3] / 1000
    for scan, points in zip(scans, theirs, strict=True):
        np.testing.assert_allclose(scan.points, points - up, atol=5e-5)
        assert scan.rays == info.w * info.h and scan.packets == 64
    counts = source.skipped
    assert (counts.damaged, counts.lost, counts.incomplete, counts.other_size) == (0, 0, 0, 0), counts
    coverage = Coverage()
    assert [coverage.add(scan.points) for scan in scans] == [None] * len(scans)


def test_two_real_sensors_in_one_capture_are_told_apart_and_fragments_are_joined() -> None:
    path = FOLDER / "same_ports_nonlegacy.pcap"
    if not path.exists():
        pytest.skip(f"needs the recording {path}: set UAVRL_RECORDINGS=FOLDER, beside which it lies in ouster")
    datagrams = list(read_datagrams(path))
    assert {len(packet) for _, packet, _ in datagrams} == {48, 16640}
