"""How the scans of a simulated LiDAR leave it: as data packets of a VLP-16, or as clouds of ROS 2 of any LiDAR."""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Iterable
from typing import Any, Protocol, TypeAlias

import numpy as np

from uavrl.sitl.ports import found, give
from uavrl_onboard.lidar.packets import PORT, PacketStream, encode_scan
from uavrl_onboard.lidar.ros_messages import CLOUD
from uavrl_onboard.ros2.dds import Node, idl_type, topic_of
from uavrl_onboard.ros2.vehicle import header_at

Message: TypeAlias = "bytes | np.ndarray"
"""A data packet, or a cloud ``float32 [R, 3]`` in the sensor's frame, NaN for misses."""
FRAME = "lidar"  # of the clouds
_APART = 0.03  # s between the clouds of two sensors
_FLOAT32 = 7  # PointField's type
_POINT = 12  # bytes


class LidarOutput(Protocol):
    """Where the scans go, and in which form."""

    def add(self, points: np.ndarray, rays: slice, begun: float) -> list[tuple[float, Message]]:
        """What can be sent after some rays were cast, each with the time of its last ray in s.

        Args:
            points: ``[R, 3]``, the newest ones of the turn, in firing order.
            rays: those that were cast since the last call.
            begun: when the turn began, s.
        """

    def whole(self, points: np.ndarray, now: float) -> list[Message]:
        """What a turn ``[R, 3]`` is sent as, whose first ray was fired ``now``, s."""

    def send(self, messages: Iterable[Message]) -> None:
        """Sends what the LiDAR sends."""

    def send_as_another(self, messages: Iterable[Message]) -> None:
        """Sends what another LiDAR sends to the same place."""

    def close(self) -> None:
        """Gives its ports back."""


class PacketOutput:
    """Sends the data packets of a VLP-16 by UDP.

    Args:
        address: ``udp://HOST:PORT``.

    Raises:
        UavrlError: for what is no address, or a host that nobody knows.
    """

    def __init__(self, address: str) -> None:
        self._to, self._stream = found(address, PORT), PacketStream()
        self._sensor, self._other_sensor = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))

    def add(self, points: np.ndarray, rays: slice, begun: float) -> list[tuple[float, Message]]:
        """The packets that are full."""
        return [*self._stream.add(points[rays], rays.start, begun)]

    def whole(self, points: np.ndarray, now: float) -> list[Message]:
        """All packets of a turn."""
        return [*encode_scan(points, now)]

    def send(self, messages: Iterable[Message]) -> None:
        """Sends packets."""
        for packet in messages:
            give(self._sensor, packet, self._to)

    def send_as_another(self, messages: Iterable[Message]) -> None:
        """Sends packets from a port of another sensor."""
        for packet in messages:
            give(self._other_sensor, packet, self._to)

    def close(self) -> None:
        """Gives its ports back."""
        self._sensor.close()
        self._other_sensor.close()


class CloudOutput:
    """Publishes a turn of any LiDAR as ``sensor_msgs/PointCloud2``, stamped when it is sent, as drivers do.

    Args:
        address: ``ros2:///TOPIC`` or ``ros2://DOMAIN/TOPIC``.
        last: when the last ray of a turn is fired, in s after its first one.

    Raises:
        UavrlError: for what is no address, where cyclonedds is missing, or its domain cannot be entered.
    """

    def __init__(self, address: str, last: float) -> None:
        self._domain, self._topic = topic_of(address)
        self._last = last
        self._node, self._other_node = self._publisher(), None  # type: Node, Node | None
        self._others = deque[tuple[float, np.ndarray]]()  # clouds of the other sensor, with when to publish them

    def add(self, points: np.ndarray, rays: slice, begun: float) -> list[tuple[float, Message]]:
        """The turn, once its last ray has been cast."""
        self._publish_others()
        return [(begun + self._last, points.copy())] if rays.start < rays.stop == len(points) else []

    def whole(self, points: np.ndarray, now: float) -> list[Message]:
        """The turn."""
        self._publish_others()
        return [points]

    def send(self, messages: Iterable[Message]) -> None:
        """Publishes clouds."""
        for points in messages:
            self._node.write(self._topic, cloud_message(points, time.time()))

    def send_as_another(self, messages: Iterable[Message]) -> None:
        """Publishes clouds as another node, a while later: of two at the same moment a reader would see one alone."""
        self._others += [(time.monotonic() + _APART, np.asarray(points)) for points in messages]

    def _publish_others(self) -> None:
        while self._others and self._others[0][0] <= time.monotonic():
            self._other_node = self._other_node or self._publisher()
            self._other_node.write(self._topic, cloud_message(self._others.popleft()[1], time.time()))

    def close(self) -> None:
        """Leaves the domain."""
        self._node.close()
        if self._other_node is not None:
            self._other_node.close()

    def _publisher(self) -> Node:
        node = Node(self._domain)
        node.writes(self._topic, CLOUD)
        return node


def cloud_message(points: Any, stamp: float) -> Any:
    """A PointCloud2 of points ``[R, 3]`` in the frame ``lidar``, at a time in s since 1970; misses are NaN."""
    field = idl_type("sensor_msgs/msg/PointField")
    fields = [field(axis, 4 * number, _FLOAT32, 1) for number, axis in enumerate("xyz")]
    data = np.ascontiguousarray(points, "<f4").tobytes()
    count = len(points)
    return idl_type(CLOUD)(header_at(stamp, FRAME), 1, count, fields, False, _POINT, len(data), data, False)
