"""Recordings whose stamps do not run have the recorder's time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.helpers.captures import PACKETS
from tests.helpers.recordings import CLOUD, SCAN, cloud_message, scan_message, store, write_bag

from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.lidar.summary import ScanSummary

POINTS = np.array([[2.0, 0.0, 0.0]], np.float32)
WALL = 1_760_000_000.0  # a time of the day, s
BOOT = [100.0 + 0.1 * n for n in range(50)]


def read(path: Path) -> tuple[list[float], list[str], float | None]:
    source, summary = ScanSource(path, "VLP16"), ScanSummary()
    stamps = []
    for scan in source:
        summary.add(scan)
        stamps.append(scan.stamp)
    return stamps, source.remarks(), summary.facts()["rate_hz"]


@pytest.mark.parametrize(
    ("stamps", "replaced"),
    [
        ([0.0] * 50, "50 stamps of the recording are 0"),
        ([0.0, *BOOT[1:]], "1 stamp of the recording is 0"),
        ([*BOOT[:49], 0.0], "1 stamp of the recording is 0"),
        ([0.0, *(WALL + each for each in BOOT[1:])], "1 stamp of the recording is 0"),
        ([WALL + 5.0, *BOOT[1:]], "1 stamp of the recording is 0"),
        ([*BOOT[:20], *(WALL + each for each in BOOT[20:])], "1 stamp of the recording is 0"),
        ([each + WALL * (n % 2) for n, each in enumerate(BOOT)], "49 stamps of the recording are 0"),
        ([WALL] * 50, "49 stamps of the recording are 0"),
        ([*BOOT[:20], *(each - 3.0 for each in BOOT[20:])], "1 stamp of the recording is 0"),
    ],
    ids=["0", "first 0", "last 0", "first 0, wall", "first wall", "then wall", "mixed", "stands", "steps back"],
)
def test_where_stamps_do_not_run_the_recorder_s_time_is_used(
    stamps: list[float], replaced: str, tmp_path: Path
) -> None:
    types = store()
    path = write_bag(tmp_path / "a", "db3", {"/a": (CLOUD, [cloud_message(types, POINTS, each) for each in stamps])})
    found, remarks, rate = read(path)
    assert np.diff(found) == pytest.approx(0.1, abs=1e-5) and rate == pytest.approx(10.0, abs=1e-3)
    assert remarks == [f"{replaced}, or out of step with the recorder's clock, whose time is used instead."]


def test_stamps_that_run_are_kept(tmp_path: Path) -> None:
    """Slower than the recorder, as of a slow simulator; and with two messages out of order."""
    stamps = [5.0 + 0.05 * n for n in range(20)] + [6.1, 6.05, 6.15]
    types = store()
    path = write_bag(tmp_path / "a", "db3", {"/a": (CLOUD, [cloud_message(types, POINTS, each) for each in stamps])})
    found, remarks, _ = read(path)
    assert found == pytest.approx(stamps) and remarks == []


def test_packets_without_stamps_have_the_recorder_s_time(tmp_path: Path) -> None:
    types = store()
    messages = [scan_message(types, PACKETS[n : n + 76]) for n in range(0, len(PACKETS), 76)]
    for message in messages:
        for packet in message.packets:
            packet.stamp.sec = packet.stamp.nanosec = 0
    found, remarks, _ = read(write_bag(tmp_path / "a", "db3", {"/a": (SCAN, messages)}))
    assert len(found) == 3 and np.diff(found) == pytest.approx(0.1, abs=1e-6)
    assert remarks == [
        f"{len(PACKETS)} stamps of the recording are 0, or out of step with the recorder's clock, whose time is used "
        "instead."
    ]
