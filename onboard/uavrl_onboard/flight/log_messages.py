"""Cycles of a flight as messages of ROS 2, and back; docs/flight_log.md lists the topics."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.safety import Reason, SafetyState, SafetyStatus
from uavrl_onboard.geometry import Quaternion, roll_pitch_yaw
from uavrl_onboard.libraries import needed
from uavrl_onboard.lidar.bags import CLOUD, cloud_points
from uavrl_onboard.lidar.scans import Scan

POINTS, CELLS, GOAL = "/uavrl/points", "/uavrl/cells", "/uavrl/goal"
POSE, VELOCITY, ACTION, SETPOINT = "/uavrl/pose", "/uavrl/velocity", "/uavrl/action", "/uavrl/setpoint"
STATUS, NUMBERS, CHANGES, TRANSFORMS = "/uavrl/status", "/uavrl/numbers", "/rosout", "/tf"
TWIST = "geometry_msgs/msg/TwistStamped"
TOPICS = {
    POINTS: CLOUD,
    CELLS: "std_msgs/msg/Float32MultiArray",
    GOAL: "geometry_msgs/msg/PointStamped",
    POSE: "geometry_msgs/msg/PoseStamped",
    VELOCITY: TWIST,
    ACTION: TWIST,
    SETPOINT: TWIST,
    TRANSFORMS: "tf2_msgs/msg/TFMessage",
    CHANGES: "rcl_interfaces/msg/Log",
    NUMBERS: "uavrl_onboard/msg/FlightNumbers",
    STATUS: "std_msgs/msg/String",
}
"""The type of each topic's messages; STATUS is written last in each cycle."""

_NAMED = {"state": tuple(SafetyState), "reason": tuple(Reason), "control": tuple(Control)}
_MEASURED = ("scan_age", "pose_age", "latency", "distance")  # s and m, NaN where there is none


def numbers_definition() -> str:
    """Return the definition of `NUMBERS`, in ROS 2's own language: constants name each number of a state.

    Examples:
        >>> numbers_definition().splitlines()[:2]
        ['uint8 STATE_SILENT=0', 'uint8 STATE_STANDBY=1']
    """
    names = [f"uint8 {of}_{each}={n}".upper() for of, each_of in _NAMED.items() for n, each in enumerate(each_of)]
    constants = [name.replace("UINT8", "uint8") for name in names]
    fields = [*(f"uint8 {of}" for of in _NAMED), *(f"float64 {of}" for of in _MEASURED), "bool arrived"]
    return "\n".join(constants + fields)


WORLD, VEHICLE, LIDAR = "world", "vehicle", "lidar"
_LATEST = (2**31 - 1) * 10**9  # ns that a stamp of ROS can tell
_ALONG: Quaternion = (1.0, 0.0, 0.0, 0.0)  # the sensor is not turned on the vehicle
_INFO, _WARNING = 20, 30  # of rcl_interfaces/msg/Log


class FlightMessages:
    """Makes a cycle's messages, and a cycle of messages.

    Args:
        offset: nanoseconds that a cycle's time is behind those since 1970.
        goal: x, y, z in the world's axes, m.
        sensor_position: of the LiDAR in body axes, m.
    """

    def __init__(self, offset: int, goal: Sequence[float], sensor_position: Sequence[float]) -> None:
        types = needed("rosbags.typesys", "A flight log", "log")
        self._offset, self._goal, self._sensor = offset, tuple(goal), tuple(sensor_position)
        self._store = types.get_typestore(types.Stores.ROS2_HUMBLE)
        self._store.register(types.get_types_from_msg(numbers_definition(), TOPICS[NUMBERS]))
        field = self._type("sensor_msgs/msg/PointField")
        self._fields = [field(name=axis, offset=4 * n, datatype=7, count=1) for n, axis in enumerate("xyz")]

    def definition(self, kind: str) -> bytes:
        """The text that tells other programs what a message of this type holds."""
        text: str = self._store.generate_msgdef(kind, ros_version=2)[0]
        return text.encode()

    def nanoseconds(self, time: float) -> int:
        """A time of the loop's clock as nanoseconds since 1970."""
        since = round(time * 1e9) + self._offset if math.isfinite(time) else 0
        return min(max(since, 0), _LATEST)

    def encode(self, cycle: FlightCycle) -> list[tuple[str, bytes]]:
        """The messages of one cycle, by topic."""
        now, scan, pose, status = cycle.time, cycle.scan, cycle.pose, cycle.status
        made: list[tuple[str, Any]] = []
        if scan is not None:
            made.append((POINTS, self._cloud(scan)))
        if cycle.cells is not None:
            made.append((CELLS, self._array(cycle.cells)))
        if pose is not None:
            place = {"position": self._xyz("Point", pose.position), "orientation": self._turned(pose.rotation)}
            made.append((POSE, self._stamped("PoseStamped", pose.stamp, WORLD, pose=self._made("Pose", **place))))
            made.append((VELOCITY, self._twist(pose.stamp, WORLD, (*pose.velocity, 0.0))))
        if cycle.action is not None:
            made.append((ACTION, self._twist(now, VEHICLE, cycle.action)))
        if status.setpoint is not None:
            made.append((SETPOINT, self._twist(now, VEHICLE, status.setpoint)))
        made.append((TRANSFORMS, self._type(TOPICS[TRANSFORMS])(transforms=self._frames(now, pose))))
        if status.changed:
            made.append((CHANGES, self._change(status, now)))
        made.append((NUMBERS, self._numbers(cycle)))
        made.append((STATUS, self._type(TOPICS[STATUS])(data=_status_text(cycle))))
        return [(topic, bytes(self._store.serialize_cdr(message, TOPICS[topic]))) for topic, message in made]

    def encode_goal(self, now: float) -> bytes:
        """The message that tells where the goal is."""
        message = self._stamped("PointStamped", now, WORLD, point=self._xyz("Point", self._goal))
        return bytes(self._store.serialize_cdr(message, TOPICS[GOAL]))

    def decode(self, log_time: int, messages: Mapping[str, bytes]) -> FlightCycle:
        """The cycle whose messages these are, by topic. What does not fit raises an error of some kind."""
        found = {
            topic: self._store.deserialize_cdr(data, TOPICS[topic])
            for topic, data in messages.items()
            if topic in TOPICS
        }
        told = json.loads(found[STATUS].data)
        safety, vehicle = told["safety"], told["vehicle"]
        safety |= {"state": SafetyState(safety["state"]), "reason": Reason(safety["reason"])}
        safety |= {"limited": tuple(safety["limited"]), "setpoint": _action(found.get(SETPOINT))}
        action, cells = _action(found.get(ACTION)), found.get(CELLS)
        return FlightCycle(
            time=1e-9 * (log_time - self._offset),
            scan=self._scan(found.get(POINTS), told["scan"]),
            cells=None if cells is None else np.array(cells.data, np.float32),
            pose=self._pose(found.get(POSE), found.get(VELOCITY)),
            distance=told["distance"],
            action=None if action is None else np.array(action),
            control=VehicleStatus(**{**vehicle, "control": Control(vehicle["control"])}),
            status=SafetyStatus(**safety),
            latency=told["latency"],
            arrived=bool(told["arrived"]),
            turn=told.get("turn"),  # older logs do not tell
        )

    # What messages are made of.

    def _type(self, name: str) -> Any:
        return self._store.types[name]

    def _made(self, name: str, **values: Any) -> Any:
        return self._type(f"geometry_msgs/msg/{name}")(**values)

    def _header(self, time: float, frame: str) -> Any:
        second, nanosecond = divmod(self.nanoseconds(time), 10**9)
        stamp = self._type("builtin_interfaces/msg/Time")(sec=second, nanosec=nanosecond)
        return self._type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)

    def _stamped(self, name: str, time: float, frame: str, **values: Any) -> Any:
        return self._made(name, header=self._header(time, frame), **values)

    def _xyz(self, name: str, numbers: Sequence[float] | np.ndarray) -> Any:
        return self._made(name, **{axis: float(number) for axis, number in zip("xyz", numbers, strict=True)})

    def _turned(self, rotation: Quaternion) -> Any:
        return self._made("Quaternion", **dict(zip("wxyz", rotation, strict=True)))

    def _twist(self, time: float, frame: str, action: Sequence[float] | np.ndarray) -> Any:
        """Three velocities and a rate around the z axis."""
        parts = {"linear": self._xyz("Vector3", action[:3]), "angular": self._xyz("Vector3", (0.0, 0.0, action[3]))}
        return self._stamped("TwistStamped", time, frame, twist=self._made("Twist", **parts))

    def _cloud(self, scan: Scan) -> Any:
        points = np.ascontiguousarray(scan.points, np.float32)
        sizes = {"height": 1, "width": len(points), "point_step": 12, "row_step": 12 * len(points)}
        more = {"fields": self._fields, "is_bigendian": False, "is_dense": bool(np.isfinite(points).all())}
        data = np.frombuffer(points.astype("<f4", copy=False).tobytes(), np.uint8)
        return self._type(CLOUD)(header=self._header(scan.stamp, LIDAR), data=data, **sizes, **more)

    def _array(self, cells: np.ndarray) -> Any:
        one = self._type("std_msgs/msg/MultiArrayDimension")(label="cells", size=len(cells), stride=len(cells))
        layout = self._type("std_msgs/msg/MultiArrayLayout")(dim=[one], data_offset=0)
        return self._type(TOPICS[CELLS])(layout=layout, data=np.asarray(cells, np.float32))

    def _frames(self, now: float, pose: Pose | None) -> list[Any]:
        """Where the sensor is on the vehicle, and the vehicle in the world."""
        places = [(now, VEHICLE, LIDAR, self._sensor, _ALONG)]
        if pose is not None and np.isfinite([*pose.position, pose.yaw]).all():
            places.append((pose.stamp, WORLD, VEHICLE, pose.position, pose.rotation))
        return [
            self._stamped(
                "TransformStamped",
                time,
                frame,
                child_frame_id=child,
                transform=self._made(
                    "Transform", translation=self._xyz("Vector3", position), rotation=self._turned(rotation)
                ),
            )
            for time, frame, child, position, rotation in places
        ]

    def _numbers(self, cycle: FlightCycle) -> Any:
        """What plots show of a cycle."""
        status = cycle.status
        told = {"state": status.state, "reason": status.reason, "control": cycle.control.control}
        numbers: dict[str, Any] = {of: _NAMED[of].index(each) for of, each in told.items()}
        measured = (status.scan_age, status.pose_age, cycle.latency, cycle.distance)
        for name, value in zip(_MEASURED, measured, strict=True):
            numbers[name] = math.nan if value is None else float(value)
        return self._type(TOPICS[NUMBERS])(**numbers, arrived=bool(cycle.arrived))

    def _change(self, status: SafetyStatus, now: float) -> Any:
        level = _INFO if status.state in (SafetyState.FLYING, SafetyState.STANDBY, SafetyState.FENCED) else _WARNING
        text = f"{status.state} ({status.reason}): {status.sentence}"
        where = {"name": "uavrl.safety", "file": "", "function": "", "line": 0}
        return self._type(TOPICS[CHANGES])(stamp=self._header(now, "").stamp, level=level, msg=text, **where)

    # What they tell.

    def _seconds(self, header: Any) -> float:
        return 1e-9 * (header.stamp.sec * 10**9 + header.stamp.nanosec - self._offset)

    def _scan(self, cloud: Any, counts: Any) -> Scan | None:
        if cloud is None:
            return None
        points = cloud_points(cloud)
        if points is None:
            raise ValueError("its points do not fit their fields")
        return Scan(self._seconds(cloud.header), points, int(counts["rays"]), int(counts["misses"]))

    def _pose(self, message: Any, velocity: Any) -> Pose | None:
        if message is None:
            return None
        at, turned, speed = message.pose.position, message.pose.orientation, velocity.twist.linear
        roll, pitch, yaw = roll_pitch_yaw((turned.w, turned.x, turned.y, turned.z))
        velocity = speed.x, speed.y, speed.z
        return Pose(self._seconds(message.header), (at.x, at.y, at.z), velocity, yaw, roll, pitch)


def _status_text(cycle: FlightCycle) -> str:
    """What has no message of its own, as JSON."""
    scan = None if cycle.scan is None else {"rays": cycle.scan.rays, "misses": cycle.scan.misses}
    told = {
        "safety": cycle.status.as_dict(),
        "vehicle": asdict(cycle.control),
        "scan": scan,
        "distance": cycle.distance,
        "latency": cycle.latency,
        "arrived": cycle.arrived,
        "turn": cycle.turn,
    }
    return json.dumps(_plain(told), allow_nan=False)


def _plain(value: Any) -> Any:
    """A value as JSON can write it: a number that is not finite is null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def _action(message: Any) -> tuple[float, float, float, float] | None:
    if message is None:
        return None
    linear, angular = message.twist.linear, message.twist.angular
    return linear.x, linear.y, linear.z, angular.z
