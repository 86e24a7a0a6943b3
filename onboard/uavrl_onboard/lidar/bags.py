"""Recordings of ROS: rosbag1, rosbag2 (a folder or its .db3) and MCAP, read by `rosbags`.

Messages are read by the definitions in `uavrl_onboard.lidar.ros_messages`, never by those that a file brings: nothing
that a file says is executed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import is_return
from uavrl_onboard.libraries import needed
from uavrl_onboard.lidar.frame_ids import CloudFrame
from uavrl_onboard.lidar.mcap_file import MAGIC, McapFile
from uavrl_onboard.lidar.ros_messages import CLOUD, DEFINITIONS, ROS1, SCAN
from uavrl_onboard.lidar.scans import Scan, Skipped
from uavrl_onboard.pluralize import pluralize

ROSBAG1 = b"#ROSBAG V2.0"
_STANDS = 0.01  # s by the recorder's clock in which a stamp has to move on
_BACK = 0.5  # s by which a message may be stamped before the one before it: they come out of order
_AHEAD = 10.0  # s by which stamps may run ahead of the recorder's clock, which may stop for a slow disk
_FLOATS = {7: "f4", 8: "f8"}  # sensor_msgs/PointField's numbers for float32 and float64


class Topic(NamedTuple):
    """A topic of a recording that holds scans."""

    name: str
    kind: str  #: ``SCAN`` or ``CLOUD``


def is_rosbag1(path: Path) -> bool:
    """Whether a file is a rosbag of ROS 1."""
    return _begins(path, ROSBAG1)


def _begins(path: Path, mark: bytes) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(mark)) == mark


def scan_topic(path: Path, topic: str | None = None) -> Topic:
    """The topic of a recording that holds scans: the one that is named, or the only one.

    Raises:
        UavrlError: where there is none or more than one, or the file is none of the four kinds.
    """
    with _opened(path) as bag:
        found = {c.topic: Topic(c.topic, c.msgtype) for c in bag.connections if c.msgtype in (SCAN, CLOUD)}
        others = sorted({c.topic for c in bag.connections} - set(found))
    if topic is None and len(found) == 1:
        return next(iter(found.values()))
    if topic in found:
        return found[topic]
    if found:
        came = "more than one" if topic is None else f"no {topic}"
        raise UavrlError(f"{path} holds {came} with scans: give topic=NAME, one of {', '.join(found)}.")
    raise UavrlError(
        f"{path} holds no topic of {SCAN} or {CLOUD}, only {', '.join(others) or 'nothing'}: give another recording."
    )


class RecordedClock:
    """Gives the messages of a recording times that run.

    These are the stamps of the messages. Where one is 0, or steps against the recorder's clock, as where the time since
    boot and the time of the day are mixed, the recorder's clock says how much time has passed since the one before.

    Attributes:
        replaced: how many stamps were replaced by the recorder's time.

    Examples:
        >>> clock = RecordedClock()
        >>> [clock.time(said, recorded) for said, recorded in [(0.0, 50.0), (9.0, 50.5), (9.25, 51.0), (9000.0, 51.5)]]
        [50.0, 50.5, 50.75, 51.25]
        >>> clock.replaced
        2
    """

    def __init__(self) -> None:
        self.replaced = 0
        self._before: tuple[float, float, float] | None = None  # what it said, when it was recorded, the time given

    def time(self, said: float, recorded: float) -> float:
        """Return the time of a message, s.

        Args:
            said: its own stamp, s.
            recorded: when the recorder received it, s.
        """
        runs = said != 0.0
        if self._before is None:
            time = said if runs else recorded
        else:
            step, passed = said - self._before[0], recorded - self._before[1]
            if runs and self._before[0] != 0.0:
                stands = step == 0.0 and passed > _STANDS
                runs = not stands and -_BACK < step < passed + _AHEAD
                passed = step if runs else passed
            time = self._before[2] + passed
        self.replaced += not runs
        self._before = said, recorded, time
        return time

    def sentence(self) -> str | None:
        """Say how many stamps do not run, where some do not."""
        if not self.replaced:
            return None
        stamps = f"{pluralize(self.replaced, 'stamp')} of the recording {'is' if self.replaced == 1 else 'are'} 0"
        return f"{stamps}, or out of step with the recorder's clock, whose time is used instead."


def read_packets(path: Path, topic: str, skipped: Skipped, clock: RecordedClock) -> Iterator[tuple[float, bytes]]:
    """The stamp in seconds and the bytes of each packet in a recording's messages of VelodyneScan."""
    for recorded, message in _messages(path, topic, skipped):
        for packet in message.packets:
            yield clock.time(seconds(packet.stamp), recorded), packet.data.tobytes()


def read_clouds(path: Path, topic: str, skipped: Skipped, clock: RecordedClock) -> Iterator[Scan]:
    """The scans in a recording's messages of PointCloud2.

    Raises:
        UavrlError: for clouds that are not in the frame of one sensor.
    """
    frame = CloudFrame()
    for recorded, message in _messages(path, topic, skipped):
        if refusal := frame.refusal(message.header.frame_id):
            raise UavrlError(f"The clouds on {topic} of {path} cannot be used: {refusal}.")
        if scan := cloud_scan(message, clock.time(seconds(message.header.stamp), recorded), skipped):
            yield scan


def cloud_scan(message: Any, stamp: float, skipped: Skipped) -> Scan | None:
    """The scan in a PointCloud2; one whose fields and data do not fit each other is counted."""
    points = cloud_points(message)
    if points is None:
        skipped.malformed += 1
        return None
    return Scan(stamp, points, len(points), int((~is_return(points)).sum()))


def cloud_points(message: Any) -> np.ndarray | None:
    """The points ``float32 [P, 3]`` of a PointCloud2; None where its fields and its data do not fit each other."""
    fields = {field.name: field for field in message.fields}
    if not {"x", "y", "z"} <= set(fields):
        return None
    order = ">" if message.is_bigendian else "<"
    kinds = [_FLOATS.get(fields[axis].datatype) for axis in "xyz"]
    offsets = [fields[axis].offset for axis in "xyz"]
    rows, width, step, row_step = message.height, message.width, message.point_step, message.row_step
    if rows * width == 0:
        return np.empty((0, 3), np.float32)
    data = np.frombuffer(message.data, np.uint8)
    if None in kinds or step == 0 or row_step < width * step or len(data) < rows * row_step:
        return None
    if any(offset + int(str(kind)[1]) > step for offset, kind in zip(offsets, kinds, strict=True)):
        return None
    formats = [f"{order}{kind}" for kind in kinds]
    point = np.dtype({"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": step})
    packed = data[: rows * row_step].reshape(rows, row_step)[:, : width * step]
    read = np.frombuffer(np.ascontiguousarray(packed).tobytes(), point)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack([read[axis].astype(np.float32) for axis in "xyz"], -1)


def seconds(stamp: Any) -> float:
    """A time of ROS."""
    return stamp.sec + 1e-9 * stamp.nanosec


def _messages(path: Path, topic: str, skipped: Skipped) -> Iterator[tuple[float, Any]]:
    """The messages of one topic; those that cannot be read are counted."""
    read = _reader_of_messages(is_rosbag1(path))
    with _opened(path) as bag:
        connections = [connection for connection in bag.connections if connection.topic == topic]
        messages = bag.messages(connections=connections)
        while True:
            try:
                connection, stamp, data = next(messages)
            except StopIteration:
                return
            except Exception:  # what `rosbags` meets in a damaged file, from zstd, sqlite or its own code
                skipped.malformed += 1
                return
            try:
                message = read(data, connection.msgtype)
            except Exception:  # a damaged message meets any of its fields' types
                skipped.malformed += 1
                continue
            yield stamp * 1e-9, message


def _rosbags(module: str) -> Any:
    return needed(f"rosbags.{module}", "A recording of ROS", "lidar")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A reader of a recording; what cannot be opened is one sentence."""
    module = _rosbags("rosbag1" if is_rosbag1(path) else "rosbag2")
    with ExitStack() as stack:
        try:
            bag = stack.enter_context(module.Reader(path))
        except Exception as error:  # `rosbags` meets damage with errors of many kinds
            bag = McapFile(path) if _begins(path, MAGIC) else None  # cut off: nobody has written its index
            if bag is None or not bag.connections:
                raise UavrlError(f"{path} is no recording of ROS, or is damaged: give another one.") from error
        yield bag


@cache
def _reader_of_messages(ros1: bool) -> Callable[[bytes, str], Any]:
    """What makes a message of its bytes and the name of its type."""
    types = _rosbags("typesys")
    store = types.get_typestore(types.Stores.EMPTY)
    for name, text in (ROS1 if ros1 else DEFINITIONS).items():
        store.register(types.get_types_from_msg(text, name))
    return store.deserialize_ros1 if ros1 else store.deserialize_cdr
