"""Whole recordings of real sensors, which lie outside the repository: docs/lidar.md says where they come from."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.helpers.folders import ROOT
from uavrl_onboard.lidar.bags import RecordedClock, read_packets
from uavrl_onboard.lidar.packets import PACKET
from uavrl_onboard.lidar.scans import Skipped
from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.lidar.vlp16 import LASER_ELEVATIONS

FOLDER = Path(os.environ.get("UAVRL_RECORDINGS", ROOT.parent / "shared/data/vlp16"))
FIELDS = "x y z intensity return_type channel azimuth elevation distance time"
FORMATS = "<f4 <f4 <f4 u1 u1 <u2 <f4 <f4 <f4 <u4"
PCD = np.dtype({"names": FIELDS.split(), "formats": FORMATS.split()})


@pytest.fixture(params=["einride_recording.bin", "nebula_rosbag2"])
def recording(request: pytest.FixtureRequest) -> Path:
    path = FOLDER / request.param
    if not path.exists():
        pytest.skip(f"needs the recording {path}: set UAVRL_RECORDINGS=FOLDER")
    return path


@pytest.mark.parametrize("recording", ["einride_recording.bin"], indirect=True)
def test_einride_s_thousand_packets_are_13_scans(recording: Path) -> None:
    source = ScanSource(recording, "VLP16")
    scans = list(source)
    assert len(scans) == 13 and source.skipped.sentences() == []
    ranges = np.concatenate([np.linalg.norm(scan.points, axis=1) for scan in scans])
    assert round(float(ranges.min()), 3) == 0.5 and round(float(ranges.max()), 1) == 12.3
    assert 15_400 < np.median([len(scan.points) for scan in scans]) < 15_600
    assert 9.8 < 12 / (scans[-1].stamp - scans[0].stamp) < 10.1


def apart(asked: np.ndarray, known: np.ndarray) -> np.ndarray:
    """How far each of ``asked [N, 3]`` is from the nearest of ``known``: laser, range by 5 mm, azimuth by 0.1°."""
    units = np.array([1e-3, 0.005, 0.1])
    return cKDTree(known / units).query(asked / units, p=np.inf)[0]


@pytest.mark.parametrize("recording", ["nebula_rosbag2"], indirect=True)
def test_nebula_s_recording_gives_the_points_of_its_cloud(recording: Path) -> None:
    """To 5 mm and 0.1°, but for the last two blocks of each packet, where Nebula gives each ray its block's azimuth.

    The sensor turns by up to 0.33° while a block's rays are fired.
    """
    scans = list(ScanSource(recording, "VLP16"))
    assert [len(scan.points) for scan in scans] == [14_885, 14_845, 14_868, 14_816]
    content = (FOLDER / "nebula_1673400472138016708.pcd").read_bytes()
    cloud = np.frombuffer(content, PCD, offset=content.index(b"DATA binary\n") + 12)
    assert len(cloud) == 14_831
    elevations, azimuths = np.degrees(cloud["elevation"]).round(), np.degrees(cloud["azimuth"]) % 360
    theirs = np.stack([elevations, cloud["distance"], azimuths], -1)
    points = scans[-1].points.astype(np.float64)
    ranges = np.linalg.norm(points, axis=1)
    lasers = np.degrees(np.arcsin(points[:, 2] / ranges))
    assert np.abs(lasers - lasers.round()).max() < 0.01
    ours = np.stack([lasers.round(), ranges, np.degrees(np.arctan2(-points[:, 1], points[:, 0])) % 360], -1)
    packets = [packet for _, packet in read_packets(recording, "/velodyne_packets", Skipped(), RecordedClock())][-150:]
    last = np.frombuffer(b"".join(packets), PACKET)["blocks"][:, 10:]
    written = np.broadcast_to(last["azimuth"][..., None] / 100, (*last.shape, 32)).reshape(-1)
    fired = np.tile(LASER_ELEVATIONS, written.size // 16)
    turned_on = apart(theirs, np.stack([fired, last["returns"]["distance"].reshape(-1) * 0.002, written], -1)) > 0.2
    turned_on &= azimuths > 2.7  # what lies before is of the packet before this turn's first one
    assert 0.8 < turned_on.mean() < 0.86, "five of six pairs of blocks"
    assert (apart(theirs[turned_on], ours) <= 1).mean() > 0.985
    assert (apart(theirs, ours)[azimuths > 2.7] <= 3.5).mean() > 0.995
