"""A hundred simulated scans, tilted and with misses, as packets and back."""

from __future__ import annotations

import pytest

from tests.helpers.lidar_scans import same_after, tilted_scans
from uavrl_onboard.lidar.packets import decode_vlp16, encode_scan
from uavrl_onboard.lidar.scans import make_decoder


@pytest.mark.parametrize("decode", [decode_vlp16, make_decoder("VLP16")], ids=["ours", "velodyne-decoder"])
def test_a_hundred_scans_come_back_to_2_mm(decode: object) -> None:
    for seed in range(10):
        for scan in tilted_scans(10, seed):
            same_after(lambda scan: decode(encode_scan(scan)), scan)  # type: ignore[operator]
