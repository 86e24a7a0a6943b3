"""Packets of an Ouster, written by its documented format (firmware 2.4, RNG19_RFL8_SIG16_NIR16 and its dual form)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

COLUMNS, BEAMS, PER_PACKET = 512, 32, 16
PACKETS = COLUMNS // PER_PACKET
SERIAL, FROM_AXIS, UP = 992146000760, 15.806, 36.18  # mm: of a beam's origin from the axis, of the axis' middle
ELEVATIONS = np.linspace(21.3, -21.7, BEAMS).round(2)
AZIMUTHS = np.tile([4.27, 1.43, -1.4, -4.24], BEAMS // 4)
SINGLE, DUAL = "RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL"
PIXEL = {
    SINGLE: np.dtype([("range", "<u4"), ("reflectivity", "u1"), ("_", "u1", 7)]),
    DUAL: np.dtype([("range", "<u4"), ("range2", "<u4"), ("_", "u1", 8)]),
}


def need_sdk() -> None:
    """Skip the tests of a module where `ouster-sdk` is not installed."""
    pytest.importorskip("ouster.sdk.core", reason="needs ouster-sdk: pip install --no-deps ouster-sdk")


def metadata_of(profile: str = SINGLE, **changed: Any) -> dict[str, Any]:
    """What the sensor says of itself; ``changed`` are values of its data format."""
    form = {"columns_per_frame": COLUMNS, "columns_per_packet": PER_PACKET, "pixels_per_column": BEAMS}
    form |= {"column_window": [0, COLUMNS - 1], "pixel_shift_by_row": [6, 2, -2, -6] * (BEAMS // 4)}
    form |= {"udp_profile_lidar": profile, "udp_profile_imu": "LEGACY"} | changed
    upright = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, UP, 0, 0, 0, 1]
    return {
        "beam_intrinsics": {
            "beam_altitude_angles": ELEVATIONS.tolist(),
            "beam_azimuth_angles": AZIMUTHS.tolist(),
            "lidar_origin_to_beam_origin_mm": FROM_AXIS,
        },
        "calibration_status": {},
        "config_params": {"lidar_mode": "512x10", "udp_port_lidar": 7502},
        "imu_intrinsics": {"imu_to_sensor_transform": np.eye(4).ravel().tolist()},
        "lidar_data_format": form,
        "lidar_intrinsics": {"lidar_to_sensor_transform": upright},
        "sensor_info": {"prod_line": "OS-1-32", "prod_sn": str(SERIAL), "initialization_id": 7, "status": "RUNNING"},
    }


def write_metadata(folder: Path, told: dict[str, Any] | None = None, name: str = "os1.json") -> Path:
    """Write a file of metadata."""
    path = folder / name
    path.write_text(json.dumps(metadata_of() if told is None else told))
    return path


def turn(
    ranges: np.ndarray | float, number: int = 1, profile: str = SINGLE, serial: int = SERIAL, clock: float | None = None
) -> list[bytes]:
    """The 32 packets of one turn.

    Args:
        ranges: ``[BEAMS, COLUMNS]`` in mm, or ``[2, BEAMS, COLUMNS]`` with two returns; 0 for a miss.
        number: of the turn.
        profile: of the packets.
        serial: number of the sensor.
        clock: of the sensor at the beginning of the turn, s; a tenth of a second for each turn unless told.
    """
    both = np.broadcast_to(np.asarray(ranges, np.uint32), (2, BEAMS, COLUMNS))
    began, pixel = 0.1 * number if clock is None else clock, PIXEL[profile]
    column = np.dtype([("time", "<u8"), ("number", "<u2"), ("status", "<u2"), ("pixels", pixel, BEAMS)])
    head = np.dtype([("type", "<u2"), ("frame", "<u2"), ("init", "u1", 3), ("serial", "u1", 5), ("_", "u1", 20)])
    packet = np.dtype([("head", head), ("columns", column, PER_PACKET), ("_", "u1", 32)])
    packets = np.zeros(PACKETS, packet)
    packets["head"]["type"], packets["head"]["frame"] = 1, number % 2**16
    packets["head"]["init"] = np.frombuffer((7).to_bytes(3, "little"), np.uint8)
    packets["head"]["serial"] = np.frombuffer(serial.to_bytes(5, "little"), np.uint8)
    at = np.arange(COLUMNS).reshape(PACKETS, PER_PACKET)
    packets["columns"]["time"] = np.round((began + at * (0.1 / COLUMNS)) * 1e9)
    packets["columns"]["number"], packets["columns"]["status"] = at, 1
    packets["columns"]["pixels"]["range"] = both[0].T.reshape(PACKETS, PER_PACKET, BEAMS)
    if profile == DUAL:
        packets["columns"]["pixels"]["range2"] = both[1].T.reshape(PACKETS, PER_PACKET, BEAMS)
    return [each.tobytes() for each in packets]


def points_of(ranges: np.ndarray) -> np.ndarray:
    """The points ``[BEAMS, COLUMNS, 3]`` of ranges in mm, by the formula of the sensor's manual, in m from its axis."""
    encoder = 2 * np.pi * (1 - np.arange(COLUMNS) / COLUMNS)
    azimuth, elevation = -np.radians(AZIMUTHS)[:, None], np.radians(ELEVATIONS)[:, None]
    along = (ranges - FROM_AXIS) * np.cos(elevation)
    x = along * np.cos(encoder + azimuth) + FROM_AXIS * np.cos(encoder)
    y = along * np.sin(encoder + azimuth) + FROM_AXIS * np.sin(encoder)
    z = (ranges - FROM_AXIS) * np.sin(elevation) + 0 * encoder
    return np.stack([-x, -y, z], -1) / 1000  # x and y of the lidar frame point backwards and to the right
