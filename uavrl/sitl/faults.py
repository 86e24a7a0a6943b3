"""What may go wrong between a sensor, an autopilot and a companion: for tests and rehearsals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from uavrl.errors import UavrlError
from uavrl_onboard.geometry import yaw_rotation
from uavrl_onboard.lidar.packets import FULL_TURN, PACKET

Span = tuple[float, float]
Three = tuple[float, float, float]
POSE = (30, 31, 32, 33, 331)
"""ATTITUDE, ATTITUDE_QUATERNION, LOCAL_POSITION_NED, GLOBAL_POSITION_INT, ODOMETRY: where the vehicle is."""
_PLACES = (32, 331)  # of them, those whose x, y and z are metres to the north, to the east and down
_ODOMETRY = 331
_SECOND = 0.5  # by which the second sensor's ranges differ: it is elsewhere
_CAMERA = {"type": 30, "autopilot": 8, "base_mode": 0, "custom_mode": 0, "system_status": 4, "mavlink_version": 3}
_TIMES = ("time_boot_ms", "time_usec")
_SPEEDS = ("vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed")
_SPANS = (
    *("lidar_silent", "pose_silent", "half_scan", "frozen_scan", "turned_scan", "second_sensor"),
    *("pose_jump", "pose_drift", "frozen_pose", "slow_pose"),
)


@dataclass
class Faults:
    """Faults of the way; times are in s from the first set-point that was obeyed, and end before the second number.

    Args:
        lose: share of the LiDAR's packets, or of its clouds, that are lost.
        reorder: share of them that come after the next one.
        lidar_silent: from when to when the LiDAR sends nothing.
        pose_silent: from when to when the autopilot does not say where the vehicle is.
        product: product byte of the LiDAR's packets; clouds have none.
        half_scan: from when to when the half behind the sensor has no returns, as by a driver's window.
        frozen_scan: from when to when the LiDAR repeats what it saw at first, as a driver that hangs.
        turned_scan: from when to when the LiDAR is turned by ``turn``, as it is mounted or by its driver.
        turn: to the right, degrees.
        second_sensor: from when to when another LiDAR sends to the same port or topic, from a port or node of its own.
        pose_jump: from when to when the autopilot tells a position that is off by ``jump``.
        jump: by how much, to the east, to the north and up, m.
        pose_drift: from when to when the reported position drifts away by ``drift``, and stays there.
        drift: how fast, to the east, to the north and up, m/s. The reported velocity is true.
        frozen_pose: from when to when the reported pose is the first one, with no velocity, as if the estimator hung.
        reset: when the autopilot's estimator resets: its counter in ODOMETRY goes up.
        clock_step: when the autopilot's clock steps, and by how much, s.
        slow_pose: from when to when the pose is sent ``pose_rate`` times per second only.
        pose_rate: Hz.
        camera: a camera on the vehicle sends heartbeats, from the first moment on.
        signing_key_file: the autopilot signs what it sends by the key in this file, and obeys signed messages only.
        seed: of what is lost.

    Examples:
        >>> faults = Faults(lidar_silent=(1.0, 2.0), product=0x21)
        >>> faults.of_lidar([bytes(1206)], 1.5), faults.of_lidar([bytes(1206)], 2.0)[0][-1]
        ([], 33)
    """

    lose: float = 0.0
    reorder: float = 0.0
    lidar_silent: tuple[float, float] | None = None
    pose_silent: tuple[float, float] | None = None
    product: int | None = None
    half_scan: tuple[float, float] | None = None
    frozen_scan: tuple[float, float] | None = None
    turned_scan: tuple[float, float] | None = None
    turn: float = 90.0
    second_sensor: tuple[float, float] | None = None
    pose_jump: tuple[float, float] | None = None
    jump: tuple[float, float, float] = (20.0, 0.0, 0.0)
    pose_drift: tuple[float, float] | None = None
    drift: tuple[float, float, float] = (1.5, 0.0, 0.0)
    frozen_pose: tuple[float, float] | None = None
    reset: float | None = None
    clock_step: tuple[float, float] | None = None
    slow_pose: tuple[float, float] | None = None
    pose_rate: float = 5.0
    camera: bool = False
    signing_key_file: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks what the shares and times say."""
        for name in ("lose", "reorder"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise UavrlError(f"faults.{name} must be a share in [0, 1], got {getattr(self, name)}.")
        for name in _SPANS:
            span = getattr(self, name)
            if span is not None and not 0.0 <= span[0] <= span[1]:
                raise UavrlError(f"faults.{name} must be two times in s from 0, the earlier first, got {list(span)}.")
        for name, number in (("reset", self.reset), ("clock_step", self.clock_step and self.clock_step[0])):
            if number is not None and not 0.0 <= number < math.inf:
                raise UavrlError(f"faults.{name} must begin with a time in s from 0, got {number}.")
        if not np.isfinite([*self.jump, *self.drift]).all():
            raise UavrlError(f"faults.jump and faults.drift must be finite, got {self.jump} and {self.drift}.")
        if not math.isfinite(self.turn):
            raise UavrlError(f"faults.turn must be finite, got {self.turn}.")
        if not 0.0 < self.pose_rate < math.inf:
            raise UavrlError(f"faults.pose_rate must be above 0 Hz, got {self.pose_rate}.")
        if self.product is not None and not 0 <= self.product < 256:
            raise UavrlError(f"faults.product must be a byte, 0 to 255, got {self.product}.")
        if self.seed < 0:
            raise UavrlError(f"faults.seed must be a whole number from 0, got {self.seed}.")
        self._rng = np.random.default_rng(self.seed)
        self._kept: list[Any] = []
        self._pose_due: dict[int, float] = {}
        self._camera_due = -math.inf
        self._turn: dict[int, Any] = {}  # by azimuth: the packets of the turn that is repeated; or its cloud
        self._frozen: dict[int, dict[str, Any]] = {}  # by number: the fields of the messages that are

    def of_lidar(self, packets: Sequence[Any], since: float | None) -> list[Any]:
        """What arrives of some packets, ``since`` s after the first obeyed set-point (None: there was none yet).

        Clouds ``float32 [R, 3]`` suffer the same as packets.
        """
        if _within(self.lidar_silent, since):
            return []
        half, arrived = _within(self.half_scan, since), list[Any]()
        frozen, turned = _within(self.frozen_scan, since), _within(self.turned_scan, since)
        for packet in packets:
            form = _form_of(packet)
            if half:
                packet = form.without_half(packet)
            if frozen:
                packet = form.as_before(packet, self._turn)
            if turned:
                packet = form.turned(packet, self.turn)
            if self.product is not None:
                packet = packet[:-1] + bytes([self.product])
            if self._rng.random() < self.lose:
                continue
            kept, self._kept = self._kept, []
            if not kept and self._rng.random() < self.reorder:
                self._kept = [packet]
            else:
                arrived += [packet, *kept]
        return arrived

    def of_second_sensor(self, packets: Sequence[Any], since: float | None) -> list[Any]:
        """What another sensor sends at the same time: the same turn, seen from elsewhere."""
        return [_form_of(packet).nearer(packet) for packet in packets] if _within(self.second_sensor, since) else []

    def of_telemetry(self, messages: Iterable[Any], now: float, since: float | None) -> list[Any]:
        """What the autopilot tells of some messages of MAVLink.

        Args:
            messages: that are due; their fields are changed.
            now: the vehicle's clock, s.
            since: s after the first obeyed set-point; None: there was none yet.
        """
        told = [message for message in messages if not self._is_hidden(message, now, since)]
        for message in told:
            number = message.get_msgId()
            if number in POSE and _within(self.frozen_pose, since):
                self._freeze(message)
            if number in _PLACES:
                east, north, up = self._off(since)
                message.x, message.y, message.z = message.x + north, message.y + east, message.z - up
            if number == _ODOMETRY:
                message.reset_counter += self.reset is not None and since is not None and since >= self.reset
            if self.clock_step is not None and since is not None and since >= self.clock_step[0]:
                _step_clock(message, self.clock_step[1])
        return told

    def _freeze(self, message: Any) -> None:
        """Let a message tell what the first of its kind has told, but for the time."""
        fields = {name: getattr(message, name) for name in message.get_fieldnames() if name not in _TIMES}
        fields |= {name: type(value)(0) for name, value in fields.items() if name in _SPEEDS}
        for name, value in self._frozen.setdefault(message.get_msgId(), fields).items():
            setattr(message, name, value)

    def camera_beats(self, now: float) -> dict[str, int] | None:
        """The fields of the camera's heartbeat, where one is due."""
        if not self.camera or now < self._camera_due:
            return None
        self._camera_due = now + 1.0
        return _CAMERA

    def _is_hidden(self, message: Any, now: float, since: float | None) -> bool:
        """Whether a message is not sent: the pose is silent, or slow."""
        number = message.get_msgId()
        if number not in POSE:
            return False
        if _within(self.slow_pose, since):
            if now < self._pose_due.get(number, -math.inf):
                return True
            self._pose_due[number] = now + 1.0 / self.pose_rate
        return _within(self.pose_silent, since)

    def _off(self, since: float | None) -> np.ndarray:
        """How far the reported position is off, ``[3]`` in m: east, north, up."""
        off = np.array(self.jump) if _within(self.pose_jump, since) else np.zeros(3)
        if self.pose_drift is not None and since is not None:
            begun, ended = self.pose_drift
            off = off + np.array(self.drift) * max(min(since, ended) - begun, 0.0)
        return off


def _within(span: Span | None, since: float | None) -> bool:
    return span is not None and since is not None and span[0] <= since < span[1]


def _without_half(packet: bytes) -> bytes:
    """The packet without the returns behind the sensor."""
    read = np.frombuffer(packet, PACKET).copy()
    azimuth = read["blocks"]["azimuth"]
    behind = (azimuth > FULL_TURN // 4) & (azimuth < 3 * FULL_TURN // 4)
    read["blocks"]["returns"]["distance"][behind] = 0
    return read.tobytes()


def _as_before(packet: bytes, turn: dict[int, bytes]) -> bytes:
    """The packet with the returns of the first turn, which is kept by the azimuth of its packets."""
    read = np.frombuffer(packet, PACKET).copy()
    azimuth = int(read["blocks"]["azimuth"][0, 0])
    before = np.frombuffer(turn.setdefault(azimuth, packet), PACKET)
    read["blocks"] = before["blocks"]
    return read.tobytes()


def _turned(packet: bytes, degrees: float) -> bytes:
    """The packet of a sensor that is turned to the right."""
    read = np.frombuffer(packet, PACKET).copy()
    azimuth = read["blocks"]["azimuth"].astype(np.int64) - round(100 * degrees)
    read["blocks"]["azimuth"] = azimuth % FULL_TURN
    return read.tobytes()


def _nearer(packet: bytes) -> bytes:
    """The packet of a sensor that is nearer to all that it sees."""
    read = np.frombuffer(packet, PACKET).copy()
    distance = read["blocks"]["returns"]["distance"]
    read["blocks"]["returns"]["distance"] = (_SECOND * distance).astype(distance.dtype)
    return read.tobytes()


def _cloud_without_half(points: np.ndarray) -> np.ndarray:
    return np.where(points[:, :1] < 0.0, np.float32(math.nan), points)


def _cloud_as_before(points: np.ndarray, turn: dict[int, Any]) -> np.ndarray:
    before: np.ndarray = turn.setdefault(0, points)
    return before


def _cloud_turned(points: np.ndarray, degrees: float) -> np.ndarray:
    return (points @ yaw_rotation(math.radians(degrees)).T).astype(np.float32)


def _cloud_nearer(points: np.ndarray) -> np.ndarray:
    return np.float32(_SECOND) * points


class _Form(NamedTuple):
    """What faults make of a message of a LiDAR."""

    without_half: Callable[[Any], Any]  #: without the returns behind the sensor
    as_before: Callable[[Any, dict[int, Any]], Any]  #: with the returns of the first turn, which is kept in the dict
    turned: Callable[[Any, float], Any]  #: of a sensor that is turned to the right, in degrees
    nearer: Callable[[Any], Any]  #: of a sensor that is nearer to all that it sees


_OF_PACKETS = _Form(_without_half, _as_before, _turned, _nearer)
_OF_CLOUDS = _Form(_cloud_without_half, _cloud_as_before, _cloud_turned, _cloud_nearer)


def _form_of(message: Any) -> _Form:
    return _OF_PACKETS if isinstance(message, bytes) else _OF_CLOUDS


def _step_clock(message: Any, by: float) -> None:
    for name, unit in (("time_boot_ms", 1e3), ("time_usec", 1e6)):
        if hasattr(message, name):
            setattr(message, name, max(getattr(message, name) + round(by * unit), 0))
