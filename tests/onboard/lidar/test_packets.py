"""Simulated scans as the packets of a VLP-16, and back."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.lidar_scans import same_after, tilted_scans
from uavrl_onboard.lidar.packets import decode_vlp16, encode_scan
from uavrl_onboard.lidar.scans import make_decoder


@pytest.mark.parametrize("decode", [decode_vlp16, make_decoder("VLP16")], ids=["ours", "velodyne-decoder"])
def test_a_scan_comes_back_to_2_mm(decode: object) -> None:
    for scan in tilted_scans(3):
        assert np.isnan(scan).any()
        borders = same_after(lambda scan: decode(encode_scan(scan)), scan)  # type: ignore[operator]
        assert borders["truncated_icosahedron"] < 0.05
        assert borders["range_image"] < 0.2, "the lasers at ±5°, two of 16, lie on the border of two rows"
