"""Reports of a flight for the tools of ROS 2: diagnostics, and markers for RViz and Foxglove."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.limits import SafetyLimits
from uavrl_onboard.flight.safety import SafetyState
from uavrl_onboard.geometry import quaternion, rotate
from uavrl_onboard.lidar.ros_messages import DIAGNOSTICS, MARKERS
from uavrl_onboard.policy.contract import Cells, Contract
from uavrl_onboard.ros2.dds import OnNode, idl_type
from uavrl_onboard.ros2.vehicle import header_at

DIAGNOSTICS_TOPIC, MARKERS_TOPIC = "/diagnostics", "/uavrl/markers"
OK, WARN, ERROR = 0, 1, 2  # DiagnosticStatus's levels
_EVERY = 1.0  # s between two diagnostics, the rate that rqt_robot_monitor and the aggregator expect
_LEVELS = {SafetyState.HOLDING: WARN, SafetyState.SILENT: ERROR}
_CONTROL_LEVELS = {Control.IN_CONTROL: OK, Control.LOST: ERROR, Control.UNSUPPORTED: ERROR}
_ARROW, _CYLINDER, _SPHERES = 0, 3, 7  # Marker's types
_ADD, _DELETE = 0, 2
_GREEN, _BLUE, _ORANGE = (0.1, 0.8, 0.2, 0.5), (0.2, 0.5, 1.0, 1.0), (1.0, 0.5, 0.0, 0.9)
_LIFETIME = 2  # s after which a viewer drops what is not sent again
_GOAL_HEIGHT = 1.0  # m, as drawn


class Ros2Reports(OnNode):
    """Publishes a flight's state to ``/diagnostics``, and its goal, cells and set-point to ``/uavrl/markers``.

    Markers are in the frame of the vehicle's positions, so a viewer needs no transforms: choose that frame as fixed
    frame. The arrow of the set-point is as long as the way in a second.

    Args:
        domain: number of the domain.
        contract: of the policy.
        goal: x, y, z in the world's axes, m.
        radius: horizontal distance from the goal at which the vehicle has arrived, m.
        limits: of the safety layer, which say how old a scan and a pose may be.
        frame: returns the name of the frame of the vehicle's positions.
        diagnostics: publish diagnostics, once a second and whenever the safety layer changes its state.
        markers: publish markers, with each cycle.

    Raises:
        UavrlError: where cyclonedds is missing, or the domain cannot be entered.
    """

    def __init__(
        self,
        domain: int,
        contract: Contract,
        goal: Sequence[float],
        *,
        radius: float = 1.0,
        limits: SafetyLimits | None = None,
        frame: Callable[[], str] = lambda: "map",
        diagnostics: bool = True,
        markers: bool = True,
    ) -> None:
        self._contract, self._goal, self._radius = contract, tuple(goal), radius
        self._limits, self._frame = limits or SafetyLimits(), frame
        self._diagnostics, self._markers = diagnostics, markers
        self._due = -math.inf
        super().__init__(domain)
        if diagnostics:
            self._node.writes(DIAGNOSTICS_TOPIC, DIAGNOSTICS)
        if markers:
            self._node.writes(MARKERS_TOPIC, MARKERS)

    def tell(self, cycle: FlightCycle) -> None:
        """Publish what is due of a cycle."""
        if self._diagnostics and (cycle.status.changed or cycle.time >= self._due):
            self._due = cycle.time + _EVERY
            self._node.write(DIAGNOSTICS_TOPIC, diagnostics_of(cycle, self._limits))
        if self._markers:
            self._node.write(MARKERS_TOPIC, self._drawn(cycle))

    def _drawn(self, cycle: FlightCycle) -> Any:
        """The MarkerArray of a cycle."""
        frame, made = self._frame() or "map", []
        around = (2.0 * self._radius, 2.0 * self._radius, _GOAL_HEIGHT)
        made.append(_marker(frame, "goal", _CYLINDER, _GREEN, scale=around, at=self._goal))
        pose = cycle.pose
        if pose is not None and np.isfinite([*pose.position, *pose.rotation]).all():
            position = np.array(pose.position)
            if cycle.cells is not None:
                seen = cell_points(cycle.cells, self._contract.cells) + self._contract.cloud.sensor_position
                points = [position + rotate(point, pose.rotation) for point in seen.tolist()]
                made.append(_marker(frame, "cells", _SPHERES, _ORANGE, scale=(0.2,) * 3, points=points))
            yaw = quaternion(0.0, 0.0, pose.yaw)
            asked = cycle.status.setpoint
            arrow = [] if asked is None else [position, position + rotate(asked[:3], yaw)]
            made.append(_marker(frame, "set-point", _ARROW, _BLUE, scale=(0.06, 0.15, 0.2), points=arrow))
        return idl_type(MARKERS)(made)


def cell_points(cells: np.ndarray, terms: Cells) -> np.ndarray:
    """Return a point ``[n, 3]`` in the sensor's axes, in m, for each cell that holds a return.

    It is at the range of the nearest return where the cells report that, and else where the cell is on the ball.

    Args:
        cells: ``[cells]``, what the policy saw of a scan.
        terms: what the cells mean.
    """
    held = cells > 0.0
    reach = {"range": cells, "proximity": terms.radius - cells}.get(terms.statistic, np.full_like(cells, terms.radius))
    return np.asarray(reach[held, None] * np.array(terms.directions)[held])


def diagnostics_of(cycle: FlightCycle, limits: SafetyLimits) -> Any:
    """The DiagnosticArray of a cycle: the flight, the LiDAR and the vehicle."""
    status, control, setpoint = cycle.status, cycle.control, cycle.status.setpoint
    flight = {
        "reason": status.reason,
        "set-point": "none" if setpoint is None else " ".join(f"{each:.2f}" for each in setpoint),
        "limited by": ", ".join(status.limited),
        "distance to the goal, m": _number(cycle.distance),
        "arrived": str(cycle.arrived),
    }
    lidar, pose = _age("scan", status.scan_age, limits.scan_age), _age("pose", status.pose_age, limits.pose_age)
    vehicle = {"mode": control.mode or "", "armed": str(control.armed), "pose": pose[1]}
    level = max(_CONTROL_LEVELS.get(control.control, WARN), pose[0])
    reports = [
        ("flight", _LEVELS.get(status.state, OK), f"{status.state}: {status.sentence}", flight),
        ("LiDAR", *lidar, {"age, s": _number(status.scan_age), "latency, s": _number(cycle.latency)}),
        ("vehicle", level, f"{control.control}: {control.sentence}", vehicle),
    ]
    pair, one = idl_type("diagnostic_msgs/msg/KeyValue"), idl_type("diagnostic_msgs/msg/DiagnosticStatus")
    told = [
        one(level, f"uavrl: {name}", sentence, "uavrl", [pair(key, str(value)) for key, value in values.items()])
        for name, level, sentence, values in reports
    ]
    return idl_type(DIAGNOSTICS)(header_at(time.time(), ""), told)


def _age(of: str, age: float | None, most: float) -> tuple[int, str]:
    """A level and a sentence for the age of a scan or a pose, in s."""
    if age is None:
        return ERROR, f"there is no {of}"
    return (OK if age <= most else ERROR), f"the {of} is {age:.2f} s old"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _marker(
    frame: str,
    name: str,
    kind: int,
    color: tuple[float, float, float, float],
    *,
    scale: Sequence[float],
    at: Sequence[float] = (0.0, 0.0, 0.0),
    points: Sequence[np.ndarray] | None = None,
) -> Any:
    """A Marker; one with an empty list of points takes the one before away."""
    point, vector, turn = (idl_type(f"geometry_msgs/msg/{each}") for each in ("Point", "Vector3", "Quaternion"))
    now = idl_type("builtin_interfaces/msg/Time")(0, 0)  # the latest, whatever clock the viewer has
    header = idl_type("std_msgs/msg/Header")(now, frame)
    action = _DELETE if points is not None and not len(points) else _ADD
    place = idl_type("geometry_msgs/msg/Pose")(point(*at), turn(0.0, 0.0, 0.0, 1.0))
    lasts = idl_type("builtin_interfaces/msg/Duration")(_LIFETIME, 0)
    color_rgba = idl_type("std_msgs/msg/ColorRGBA")(*color)
    drawn = [point(*each) for each in np.asarray(points).tolist()] if points else []
    no_image = idl_type("sensor_msgs/msg/CompressedImage")(header, "", b"")
    no_mesh = idl_type("visualization_msgs/msg/MeshFile")("", b"")
    looks: tuple[Any, ...] = (
        place,
        vector(*scale),
        color_rgba,
        lasts,
        False,
        drawn,
        [],
        "",
        no_image,
        [],
        "",
        "",
        no_mesh,
        False,
    )
    return idl_type("visualization_msgs/msg/Marker")(header, name, 0, kind, action, *looks)
