"""A vehicle and a LiDAR behind real nodes of ROS 2 (`rclpy`, Fast DDS), in a process of their own.

Two posts stand on a plane. The vehicle follows velocities with a lag, and stops when none have come for half a second.
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField
from visualization_msgs.msg import MarkerArray

POSTS = ((5.0, 0.5, 0.5), (9.0, -1.5, 0.6))  # x, y, radius, m
TICK = 0.02  # s between two odometries
TURN = 5  # ticks of one turn of the sensor
PLAIN = np.dtype([(axis, "<f4") for axis in "xyz"])
VELODYNE = np.dtype([*PLAIN.descr, ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
NUMBERS = {"f": PointField.FLOAT32, "u": PointField.UINT16}
LAG, STALE = 0.25, 0.5  # s
TIMEOUT = 60.0  # s without a set-point


def rays() -> np.ndarray:
    """Directions ``[P, 3]`` of 16 lasers, a column for each degree and a half."""
    azimuths = np.radians(np.arange(0.0, 360.0, 1.5))
    up, around = (each.ravel() for each in np.meshgrid(np.radians(np.arange(-15.0, 16.0, 2.0)), azimuths))
    return np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1)


def scan(position: np.ndarray, yaw: float) -> np.ndarray:
    """The returns ``float32 [P, 3]`` in the sensor's frame."""
    directions, c, s = rays(), math.cos(yaw), math.sin(yaw)
    x, y, z = directions[:, 0] * c - directions[:, 1] * s, directions[:, 0] * s + directions[:, 1] * c, directions[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = np.where(z < 0.0, -position[2] / z, np.inf)
        for post_x, post_y, radius in POSTS:
            a, b = x * x + y * y, (position[0] - post_x) * x + (position[1] - post_y) * y
            inner = b * b - a * ((position[0] - post_x) ** 2 + (position[1] - post_y) ** 2 - radius * radius)
            hit = (-b - np.sqrt(inner)) / a
            ranges = np.where((inner > 0.0) & (hit > 0.0), np.minimum(ranges, hit), ranges)
    near = ranges < 60.0
    return (directions[near] * ranges[near, None]).astype(np.float32)


@dataclass
class Vehicle:
    """Where it is, and what it was told. ``options`` are those of `fly`."""

    options: dict[str, Any]
    node: Any
    position: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 3.0]))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    yaw: float = 0.0
    turning: float = 0.0
    told: Any = None
    told_at: float = -math.inf
    first: float | None = None
    heard: int = 0
    nearest: float = math.inf

    def hear(self, message: Any) -> None:
        """Takes in a set-point."""
        self.told, self.told_at, self.heard = getattr(message, "twist", message), time.monotonic(), self.heard + 1
        self.first = self.told_at if self.first is None else self.first

    def move(self) -> None:
        """Flies for one tick."""
        c, s, fresh = math.cos(self.yaw), math.sin(self.yaw), time.monotonic() - self.told_at < STALE
        asked, turn = np.zeros(3), 0.0
        if fresh:
            linear, turn = self.told.linear, self.told.angular.z
            asked = np.array([c * linear.x - s * linear.y, s * linear.x + c * linear.y, linear.z])
        self.velocity += (asked - self.velocity) * TICK / LAG
        self.turning += (turn - self.turning) * TICK / LAG
        self.position += self.velocity * TICK
        self.yaw += self.turning * TICK
        gaps = [math.hypot(self.position[0] - x, self.position[1] - y) - radius for x, y, radius in POSTS]
        self.nearest = min(self.nearest, *gaps, self.position[2])

    def odometry(self, stamp: Time) -> Odometry:
        """What an estimator publishes."""
        message, c, s = Odometry(), math.cos(self.yaw), math.sin(self.yaw)
        message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, "odom", "base_link"
        at, turn, moves = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist.linear
        at.x, at.y, at.z = self.position.tolist()
        turn.z, turn.w = math.sin(self.yaw / 2), math.cos(self.yaw / 2)
        x, y, z = self.velocity.tolist()
        moves.x, moves.y, moves.z = c * x + s * y, c * y - s * x, z
        return message

    def cloud(self, stamp: Time) -> PointCloud2:
        """What a driver publishes."""
        points, layout = scan(self.position, self.yaw), VELODYNE if self.options["ring"] else PLAIN
        packed = np.zeros(len(points), layout)
        for column, axis in enumerate("xyz"):
            packed[axis] = points[:, column]
        message = PointCloud2(height=1, width=len(points), point_step=layout.itemsize, is_dense=True)
        message.header.stamp, message.header.frame_id = stamp, "velodyne"
        for name in layout.names or ():
            kind, offset = layout.fields[name][:2]  # type: ignore[index]
            message.fields.append(PointField(name=name, offset=offset, datatype=NUMBERS[kind.kind], count=1))
        message.data = packed.tobytes()
        message.row_step = len(message.data)
        return message


class Stamp:
    """The time in the headers: the time of day, or a simulation's, which starts again after some seconds as a bag."""

    def __init__(self, simulated: float | None) -> None:
        self._length = simulated

    def __call__(self, flown: float) -> Time:
        since = time.time() if self._length is None else 1000.0 + flown % self._length
        return Time(sec=int(since), nanosec=int(since % 1 * 1e9))


def fly(options: dict[str, Any]) -> dict[str, Any]:
    """Flies until set-points cease for 3 s, and returns how it went.

    Args:
        options: ``stamped``, ``reliable`` and ``ring``, of the messages; ``silent``, from when to when in s the LiDAR
            is; ``restart``, when its driver is started again; ``simulated``, after how many s its time starts again.
    """
    rclpy.init()
    node = rclpy.create_node("vehicle")
    policy = ReliabilityPolicy.RELIABLE if options["reliable"] else ReliabilityPolicy.BEST_EFFORT
    quality = QoSProfile(depth=5, reliability=policy)
    driver, odometries = (
        node.create_publisher(PointCloud2, "/points", quality),
        node.create_publisher(Odometry, "/odom", quality),
    )
    vehicle, stamp = Vehicle(options, node), Stamp(options["simulated"])
    node.create_subscription(TwistStamped if options["stamped"] else Twist, "/cmd_vel", vehicle.hear, quality)
    reports: dict[str, Any] = {}
    for topic, kind in (("/diagnostics", DiagnosticArray), ("/uavrl/markers", MarkerArray)):
        node.create_subscription(kind, topic, lambda message, topic=topic: reports.__setitem__(topic, message), 10)
    begun, tick, restarted = time.monotonic(), 0, False
    while True:
        now = time.monotonic()
        flown = 0.0 if vehicle.first is None else now - vehicle.first
        if now - max(vehicle.told_at, begun) > (TIMEOUT if vehicle.first is None else 3.0):
            break
        made = stamp(now - begun)
        odometries.publish(vehicle.odometry(made))
        if options["restart"] and flown > options["restart"] and not restarted:
            restarted = node.destroy_publisher(driver)
            driver = node.create_publisher(PointCloud2, "/points", quality)
        if tick % TURN == 0 and not options["silent"][0] <= flown < options["silent"][1]:
            driver.publish(vehicle.cloud(made))
        tick += 1
        while (left := begun + tick * TICK - time.monotonic()) > 0:
            rclpy.spin_once(node, timeout_sec=left)
        vehicle.move()
    told = reports["/diagnostics"].status if "/diagnostics" in reports else []
    return {
        "position": vehicle.position.tolist(),
        "nearest": vehicle.nearest,
        "heard": vehicle.heard,
        "middleware": rclpy.get_rmw_implementation_identifier(),
        "diagnostics": [status.name for status in told],
        "markers": [marker.ns for marker in reports["/uavrl/markers"].markers] if "/uavrl/markers" in reports else [],
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(fly(json.loads(sys.argv[1]))) + "\n")
