"""Packets of a VLP-16: written for a test, and recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uavrl_onboard.lidar.packets import HOUR, PACKET, encode_scan
from uavrl_onboard.lidar.vlp16 import firing_directions

ROOT = Path(__file__).resolve().parents[2]
RECORDED = ROOT / "tests/data/vlp16/einride_160_packets.bin"


def turns(number: int, distance: float = 3.0, stamp: float = 0.0) -> list[bytes]:
    """The packets of some turns at 10 Hz without a seam between them, as the sensor sends them."""
    one = np.frombuffer(b"".join(encode_scan(distance * firing_directions())), PACKET)
    count = 76 * number
    packets = np.tile(one, number + 1)[:count].copy()
    block = np.arange(count * 12)
    packets["blocks"]["azimuth"] = (np.round(block * 39.8131) % 36000).reshape(-1, 12)
    packets["blocks"]["returns"]["distance"] = round(distance * 500)
    packets["time"] = np.round(stamp * 1e6 + np.arange(count) * 1327.104).astype(np.int64) % HOUR
    return [packet.tobytes() for packet in packets]
