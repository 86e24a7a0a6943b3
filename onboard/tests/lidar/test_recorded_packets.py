"""Two turns of a real sensor."""

from __future__ import annotations

import numpy as np
from tests.helpers.packets import RECORDED

from uavrl_onboard.geometry import is_return
from uavrl_onboard.lidar.packets import PACKET, STRONGEST, decode_vlp16
from uavrl_onboard.lidar.scans import make_decoder
from uavrl_onboard.lidar.sources import ScanSource, read_bare
from uavrl_onboard.perception.reductions import range_image


def test_real_packets_give_whole_turns_of_a_room() -> None:
    source = ScanSource(RECORDED, "VLP16")
    scans = list(source)
    assert [len(scan.points) for scan in scans] == [15518, 15541] and source.skipped.sentences() == []
    for scan in scans:
        ranges = np.linalg.norm(scan.points, axis=1)
        assert is_return(scan.points).all() and round(float(ranges.min()), 3) == 0.5 and 12 < ranges.max() < 13
        assert scan.misses == scan.rays - len(scan.points) and 0.45 < scan.misses / scan.rays < 0.48
        assert 50 < (range_image(scan.points) > 0).sum() < 72


def test_both_decoders_agree_on_them() -> None:
    packets = [packet for _, packet in read_bare(RECORDED)]
    ours, theirs = decode_vlp16(packets), make_decoder("VLP16")(packets)
    assert ours.shape == theirs.shape
    ranges = np.linalg.norm(theirs, axis=1)
    np.testing.assert_allclose(np.linalg.norm(ours, axis=1), ranges, rtol=1e-6)
    assert (np.linalg.norm(ours - theirs, axis=1) / ranges).max() < np.radians(0.006)


def test_what_we_write_is_of_the_form_of_what_it_sends() -> None:
    real = np.frombuffer(RECORDED.read_bytes(), PACKET)
    assert (real["mode"] == STRONGEST).all() and (real["product"] == 0x22).all()
    step = np.diff(np.unwrap(real["blocks"]["azimuth"].ravel() / 100.0, period=360))
    assert abs(step.mean() - 0.3981) < 0.002 and abs(np.diff(real["time"].astype(int)).mean() - 1327.1) < 0.1
