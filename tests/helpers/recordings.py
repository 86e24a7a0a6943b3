"""Recordings of one kind of content in every format that is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SCAN, CLOUD = "velodyne_msgs/msg/VelodyneScan", "sensor_msgs/msg/PointCloud2"
VELODYNE = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    SCAN: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
}


def store(ros1: bool = False) -> Any:
    """A typestore that knows the messages."""
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in VELODYNE.items():
        types.register(get_types_from_msg(text, name))
    return types


def _time(types: Any, stamp: float) -> Any:
    return types.types["builtin_interfaces/msg/Time"](sec=int(stamp), nanosec=round(stamp % 1 * 1e9))


def _header(types: Any, stamp: float) -> Any:
    more = {"seq": 0} if "ROS1" in str(types.name if hasattr(types, "name") else "") else {}
    kind = types.types["std_msgs/msg/Header"]
    if "seq" in kind.__dataclass_fields__:
        more = {"seq": 0}
    return kind(stamp=_time(types, stamp), frame_id="velodyne", **more)


def scan_message(types: Any, packets: list[bytes], stamp: float = 0.0) -> Any:
    """A VelodyneScan, its packets 1.327 ms apart."""
    packet = types.types["velodyne_msgs/msg/VelodynePacket"]
    listed = [
        packet(stamp=_time(types, stamp + 0.001327 * n), data=np.frombuffer(data, np.uint8))
        for n, data in enumerate(packets)
    ]
    return types.types[SCAN](header=_header(types, stamp), packets=listed)


def cloud_message(
    types: Any, points: np.ndarray, stamp: float = 0.0, *, big: bool = False, pad: int = 4, double: bool = False
) -> Any:
    """A PointCloud2 whose points have an intensity between y and z, and some bytes more at their end."""
    kind, size = ("f8", 8) if double else ("f4", 4)
    offsets = {"x": 0, "y": size, "intensity": 2 * size, "z": 2 * size + 4}
    formats = [f"{'>' if big else '<'}{'f4' if name == 'intensity' else kind}" for name in offsets]
    step = 3 * size + 4 + pad
    packed = np.zeros(
        len(points),
        np.dtype({"names": list(offsets), "formats": formats, "offsets": list(offsets.values()), "itemsize": step}),
    )
    for axis, column in zip("xyz", points.T, strict=True):
        packed[axis] = column
    field = types.types["sensor_msgs/msg/PointField"]
    number = 8 if double else 7
    fields = [
        field(name=name, offset=offset, datatype=7 if name == "intensity" else number, count=1)
        for name, offset in offsets.items()
    ]
    data = np.frombuffer(packed.tobytes(), np.uint8)
    return types.types[CLOUD](
        header=_header(types, stamp), height=1, width=len(points), fields=fields, is_bigendian=big, point_step=step,
        row_step=step * len(points), data=data, is_dense=False,
    )  # fmt: skip


def write_bag(path: Path, kind: str, topics: dict[str, tuple[str, list[Any]]]) -> Path:
    """Writes messages by topic as ``"ros1"``, ``"db3"`` or ``"mcap"``; returns what is to be opened."""
    types = store(kind == "ros1")
    if kind == "ros1":
        writer: Any = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        for topic, (msgtype, messages) in topics.items():
            connection = writer.add_connection(topic, msgtype, typestore=types)
            serialize = types.serialize_ros1 if kind == "ros1" else types.serialize_cdr
            for n, message in enumerate(messages):
                writer.write(connection, 10**8 * (n + 1), serialize(message, msgtype))
    return path
