"""Topics of ROS 2 without ROS: what its nodes say to each other over DDS, by `cyclonedds`.

A topic ``/odom`` of ROS 2 is ``rt/odom`` in DDS, and its type ``nav_msgs/msg/Odometry`` is
``nav_msgs::msg::dds_::Odometry_``; messages are plain CDR. Nothing that a message says is executed.
"""

from __future__ import annotations

import logging
import os
import re
import threading
import time
from contextlib import suppress
from functools import cache
from typing import Any, NamedTuple

from typing_extensions import Self

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.ros_messages import DEFINITIONS
from uavrl_onboard.ros2.domain import cyclonedds, enter, leave

_logger = logging.getLogger(__name__)

_ADDRESS = re.compile(r"ros2://(?P<domain>\d{0,3})(?P<topic>(/[A-Za-z_][A-Za-z0-9_]*)+)")
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_LAST_DOMAIN = 232  # the ports of those above it do not exist
_FIELD = re.compile(r"(?P<kind>[\w/]+)(?P<many>\[(?P<count>\d*)\])? (?P<name>\w+)")
_PRIMITIVES = ("byte", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
SILENCE = 1.0  # s without a message of a writer after which another one may take its place
_TICK = 0.1  # s after which the thread looks whether it shall end
_PAUSE = 0.01  # s after a message that cannot be read


class Arrived(NamedTuple):
    """A message of another node."""

    message: Any
    sent: float  #: when its writer sent it, by that machine's clock, s since 1970
    wall: float  #: when it arrived, by ours, s since 1970
    now: float  #: when it arrived, in s of ``time.monotonic``


def topic_of(address: str) -> tuple[int, str]:
    """The domain and the topic of ``ros2://DOMAIN/TOPIC``; without a domain it is ``ROS_DOMAIN_ID``, else 0.

    Examples:
        >>> topic_of("ros2://5/velodyne_points"), topic_of("ros2:///lidar/points")[1]
        ((5, '/velodyne_points'), '/lidar/points')
    """
    match = _ADDRESS.fullmatch(address)
    if match is None:
        raise UavrlError(f"An address is ros2:///TOPIC or ros2://DOMAIN/TOPIC, such as ros2:///odom, got {address!r}.")
    named = match["domain"] or os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not named.isdecimal() or int(named) > _LAST_DOMAIN:
        raise UavrlError(f"A domain of ROS 2 is a number from 0 to {_LAST_DOMAIN}, got {named!r}.")
    return int(named), match["topic"]


def check_topic(topic: str) -> str:
    """The name of a topic, if it is one."""
    if not _TOPIC.fullmatch(topic):
        raise UavrlError(f"A topic is /NAME or /NAME/NAME of letters, digits and underscores, got {topic!r}.")
    return topic


@cache
def idl_type(name: str) -> Any:
    """The class of a message, such as ``geometry_msgs/msg/Twist``, for `cyclonedds`."""
    kinds = cyclonedds("idl.types")
    kind = _struct(name, kinds.sequence[kinds.uint8])
    # cyclonedds reads and writes such a sequence one number at a time, and knows no topics of bytes.
    whole = _struct(name, bytes)
    kind.deserialize = whole.deserialize
    kind.serialize = lambda self, **how: whole.__idl__.serialize(self, **how)
    return kind


@cache
def _struct(name: str, octets: Any) -> Any:
    """The class of a message whose sequences of bytes are ``octets``."""
    kinds, fields = cyclonedds("idl.types"), {}
    for line in DEFINITIONS[name].splitlines():
        match = _FIELD.fullmatch(line)
        assert match is not None, line
        kind, count = match["kind"], match["count"]
        if kind == "uint8" and count == "":
            fields[match["name"]] = octets
            continue
        one: Any = {"bool": bool, "string": str}.get(kind) or (
            getattr(kinds, kind) if kind in _PRIMITIVES else _struct(kind.replace("/", "/msg/"), octets)
        )
        fields[match["name"]] = kinds.array[one, int(count)] if count else kinds.sequence[one] if match["many"] else one
    package, _, kind = name.split("/")
    return cyclonedds("idl").make_idl_struct(kind, f"{package}.msg.dds_.{kind}_", fields)


class Node:
    """What reads topics and writes them. A thread takes in what comes, so that its time of arrival is true.

    Readers ask for best effort, as ROS's do for sensor data, and so get what is sent with either reliability and
    durability. Writers offer reliable and volatile, which readers of either reliability take. Only the newest message
    is kept. Of several writers of a topic the first is heard, and another one only when that has fallen silent: two
    estimators would make a vehicle that jumps between two places. Where they publish in turn, that is logged once.

    Args:
        domain: number of the domain.

    Raises:
        UavrlError: where cyclonedds is missing, or its domain cannot be entered.
    """

    def __init__(self, domain: int) -> None:
        core, self._closing, self._domain = cyclonedds("core"), threading.Event(), domain
        self._participant = enter(domain)
        qos, policy = cyclonedds("qos").Qos, cyclonedds("qos").Policy
        self._reading = qos(policy.Reliability.BestEffort, policy.Durability.Volatile, policy.History.KeepLast(1))
        self._writing = qos(policy.Reliability.Reliable(0), policy.Durability.Volatile, policy.History.KeepLast(1))
        self._waiting = core.WaitSet(self._participant)
        self._readers: dict[str, Any] = {}
        self._writers: dict[str, Any] = {}
        self._conditions: list[Any] = []
        self._newest: dict[str, Arrived] = {}
        self._unreadable = set[str]()
        self._heard: dict[str, tuple[int, float]] = {}  # by topic: the writer, and when it was last heard
        self._others = set[str]()  # topics of which another writer was heard since
        self._shared = set[str]()  # topics of which that was told
        self._woken, self._waker = os.pipe()
        os.set_blocking(self._woken, False)
        os.set_blocking(self._waker, False)
        self._thread = threading.Thread(target=self._listen, name="uavrl-ros2", daemon=True)

    def reads(self, topic: str, kind: str) -> None:
        """Subscribes to a topic; call it before `start`."""
        core, sub = cyclonedds("core"), cyclonedds("sub")
        self._readers[topic] = sub.DataReader(self._participant, self._topic(topic, kind), self._reading)
        unread = core.ViewState.Any | core.InstanceState.Any | core.SampleState.NotRead
        self._conditions.append(core.ReadCondition(self._readers[topic], unread))
        self._waiting.attach(self._conditions[-1])

    def writes(self, topic: str, kind: str) -> None:
        """Offers a topic."""
        self._writers[topic] = cyclonedds("pub").DataWriter(self._participant, self._topic(topic, kind), self._writing)

    def start(self) -> None:
        """Begins to take in what comes."""
        self._thread.start()

    def fileno(self) -> int:
        """Becomes readable when something has come."""
        return self._woken

    def take(self, topic: str) -> Arrived | None:
        """The newest message that has come since the last call."""
        with suppress(BlockingIOError):
            os.read(self._woken, 4096)
        return self._newest.pop(topic, None)

    def listeners(self, topic: str) -> int:
        """How many readers a topic of ours has."""
        return int(self._writers[topic].get_publication_matched_status().current_count)

    def write(self, topic: str, message: Any) -> None:
        """Sends a message, if it can be sent at once."""
        try:
            self._writers[topic].write(message)
        except cyclonedds("core").DDSException as error:  # the network is down: the others' silence tells
            _logger.debug("A message to %s was not sent: %s", topic, error)

    def close(self) -> None:
        """Leaves the domain. Nothing more is sent."""
        if self._closing.is_set():
            return
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        for entities in (self._conditions, self._readers, self._writers):
            entities.clear()  # cyclonedds deletes what nothing refers to any more
        self._waiting = self._participant = None
        leave(self._domain)
        os.close(self._woken)
        os.close(self._waker)

    def _topic(self, topic: str, kind: str) -> Any:
        return cyclonedds("topic").Topic(self._participant, f"rt{check_topic(topic)}", idl_type(kind))

    def _listen(self) -> None:
        """Takes in what comes until the node is closed."""
        while not self._closing.is_set():
            self._waiting.wait(int(_TICK * 1e9))
            for topic, reader in self._readers.items():
                while self._take_in(topic, reader):
                    pass

    def _take_in(self, topic: str, reader: Any) -> bool:
        """Takes in one message, if there is one."""
        now, wall = time.monotonic(), time.time()
        try:
            samples = reader.take(1)
        except Exception as error:  # a text that is no UTF-8, or what else a foreign writer sends
            if topic not in self._unreadable:
                _logger.warning("A message of %s could not be read: %s", topic, error)
            self._unreadable.add(topic)
            self._closing.wait(_PAUSE)
            return False
        for sample in samples:
            if sample.sample_info.valid_data and self._is_first(topic, sample.sample_info.publication_handle, now):
                self._newest[topic] = Arrived(sample, sample.sample_info.source_timestamp * 1e-9, wall, now)
                with suppress(BlockingIOError):  # it is readable already
                    os.write(self._waker, b"\0")
        return bool(samples)

    def _is_first(self, topic: str, writer: int, now: float) -> bool:
        """Whether a writer is the one that is heard."""
        first, at = self._heard.get(topic, (writer, now))
        if writer != first and now - at <= SILENCE:
            self._others.add(topic)
            return False
        if writer == first and topic in self._others - self._shared:  # it is no driver that has started again
            self._shared.add(topic)
            _logger.warning("Two nodes publish on %s: only the first is read. Give each a topic of its own.", topic)
        self._others.discard(topic)
        self._heard[topic] = writer, now
        return True


class OnNode:
    """A stage of a flight that speaks by a node; a context manager.

    Args:
        domain: number of the domain.
    """

    def __init__(self, domain: int) -> None:
        self._node = Node(domain)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def fileno(self) -> int:
        """Becomes readable when something has come."""
        return self._node.fileno()

    def close(self) -> None:
        """Leaves the domain. Nothing more is sent: what others do then is their own to decide."""
        self._node.close()
