"""A scan of a real Livox, in the message of its own driver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.helpers.recordings import CLOUD, store, write_bag

from uavrl_onboard.lidar.sources import ScanSource

DATA = Path(__file__).parents[3] / "tests" / "data" / "livox" / "kompass_2000_points.bin"
LAYOUT = {  # of livox_ros_driver2: offset, NumPy's type, PointField's
    "x": (0, "<f4", 7),
    "y": (4, "<f4", 7),
    "z": (8, "<f4", 7),
    "intensity": (12, "<f4", 7),
    "tag": (16, "u1", 2),
    "line": (17, "u1", 2),
    "timestamp": (18, "<f8", 8),
}
STEP = 26


def message(types: object) -> object:
    known = types.types  # type: ignore[attr-defined]
    field, stamp = known["sensor_msgs/msg/PointField"], known["builtin_interfaces/msg/Time"](sec=1755694592, nanosec=0)
    more = {"seq": 0} if "seq" in known["std_msgs/msg/Header"].__annotations__ else {}
    data = np.fromfile(DATA, np.uint8)
    return known[CLOUD](
        header=known["std_msgs/msg/Header"](stamp=stamp, frame_id="livox_frame", **more),
        height=1,
        width=len(data) // STEP,
        fields=[field(name=name, offset=at, datatype=kind, count=1) for name, (at, _, kind) in LAYOUT.items()],
        is_bigendian=False,
        point_step=STEP,
        row_step=len(data),
        data=data,
        is_dense=True,
    )


@pytest.mark.parametrize("kind", ["ros1", "db3", "mcap"])
def test_its_points_and_misses_are_read(kind: str, tmp_path: Path) -> None:
    names, formats = list(LAYOUT), [each[1] for each in LAYOUT.values()]
    offsets = [each[0] for each in LAYOUT.values()]
    raw = np.fromfile(
        DATA,
        np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": STEP}),  # type: ignore[call-overload]
    )
    expected = np.stack([raw["x"], raw["y"], raw["z"]], -1)
    returned = expected.any(-1)
    bag = write_bag(tmp_path / kind, kind, {"/livox/lidar": (CLOUD, [message(store(kind == "ros1"))])})
    (scan,) = ScanSource(bag)
    found = scan.points[np.isfinite(scan.points).all(-1) & scan.points.any(-1)]
    np.testing.assert_array_equal(found, expected[returned])
    assert (scan.rays, scan.misses) == (2000, int((~returned).sum()))
    assert 0.05 < (~returned).mean() < 0.15
    elevation = np.degrees(np.arcsin(found[:, 2] / np.linalg.norm(found, axis=1)))
    assert elevation.min() > 42.0 and 52.0 < elevation.max() < 53.5  # the top of its sweep
    assert sorted(set(raw["line"])) == [0, 1, 2, 3]
