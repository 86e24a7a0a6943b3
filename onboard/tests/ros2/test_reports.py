"""What a flight publishes for the tools of ROS 2."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.logged import GOAL, contract, cycles
from tests.helpers.ros2_peer import DOMAIN, LOOPBACK, RosNode, until

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.flight.limits import SafetyLimits
from uavrl_onboard.flight.safety import SafetyState
from uavrl_onboard.lidar.ros_messages import DIAGNOSTICS, MARKERS
from uavrl_onboard.perception.reductions import range_image
from uavrl_onboard.ros2.dds import idl_type
from uavrl_onboard.ros2.reports import ERROR, OK, WARN, Ros2Reports, cell_points, diagnostics_of

pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")


def test_levels_and_sentences() -> None:
    flown = list(cycles(45))
    told = [diagnostics_of(cycle, SafetyLimits()).status for cycle in flown]
    assert {tuple(status.name for status in each) for each in told} == {
        ("uavrl: flight", "uavrl: LiDAR", "uavrl: vehicle")
    }
    levels = {
        SafetyState.FLYING: OK,
        SafetyState.STANDBY: OK,
        SafetyState.FENCED: OK,
        SafetyState.HOLDING: WARN,
        SafetyState.SILENT: ERROR,
    }
    assert [each[0].level for each in told] == [levels[cycle.status.state] for cycle in flown]
    assert {SafetyState.SILENT, SafetyState.STANDBY, SafetyState.FLYING, SafetyState.HOLDING} <= {
        cycle.status.state for cycle in flown
    }
    flight, lidar, vehicle = told[25]
    assert flight.message == f"flying: {flown[25].status.sentence}" and lidar.message == "the scan is 0.01 s old"
    assert (lidar.level, vehicle.level) == (OK, OK) and vehicle.message.startswith("in_control: PX4 flies by")
    assert {pair.key: pair.value for pair in flight.values}["arrived"] == "False"
    assert told[35][1].level == ERROR, "the sensor is silent"
    assert told[1][2].level == ERROR and told[10][2].level == WARN, "no pose, then not armed"
    lost = replace(flown[25], control=VehicleStatus(Control.LOST, "no heartbeat for 4.0 s"))
    assert diagnostics_of(lost, SafetyLimits()).status[2].level == ERROR


def test_cells_are_drawn_where_their_returns_are() -> None:
    ahead, left = np.array([[2.0, 0.0, 0.0]], np.float32), np.array([[0.0, 3.0, 0.0]], np.float32)
    terms = contract().cells
    cells = range_image(np.concatenate([ahead, left]), terms.radius, terms.statistic)
    assert cell_points(np.zeros_like(cells), terms).shape == (0, 3)
    lengths = {"range": (2.0, 3.0), "proximity": (2.0, 3.0), "face": (terms.radius, terms.radius)}
    for statistic, expected in lengths.items():
        other = terms.model_copy(update={"statistic": statistic})
        made = range_image(np.concatenate([ahead, left]), terms.radius, statistic)
        points = cell_points(made, other)
        assert np.linalg.norm(points, axis=1).tolist() == pytest.approx(expected, abs=1e-5), statistic
        assert points[0] @ [1.0, 0.0, 0.0] > 0.9 * expected[0] and points[1] @ [0.0, 1.0, 0.0] > 0.9 * expected[1]


def test_what_is_asked_for_is_published(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    node, flown = RosNode(DOMAIN), list(cycles(30))
    diagnostics = node.reader("rt/diagnostics", idl_type(DIAGNOSTICS))
    markers = node.reader("rt/uavrl/markers", idl_type(MARKERS))
    with Ros2Reports(DOMAIN, contract(), GOAL, radius=1.5, frame=lambda: "odom") as reports:
        until(lambda: reports._node.listeners("/diagnostics") and reports._node.listeners("/uavrl/markers"), "a match")
        pose = Pose(1.0, (5.0, 2.0, 3.0), (0.0, 0.0, 0.0), math.pi / 2, 0.0, 0.0)
        flying = replace(flown[25], pose=pose, status=replace(flown[25].status, setpoint=(1.0, 0.5, 0.25, 0.0)))
        reports.tell(flying)
        (drawn,) = until(lambda: markers.take(1), "markers")
        goal, cells, arrow = drawn.markers
        assert [each.ns for each in drawn.markers] == ["goal", "cells", "set-point"]
        assert {each.header.frame_id for each in drawn.markers} == {"odom"}
        assert (goal.pose.position.x, goal.pose.position.y, goal.pose.position.z, goal.scale.x) == (*GOAL, 3.0)
        assert flying.cells is not None and len(cells.points) == (flying.cells > 0).sum() and cells.action == 0
        ends = [(each.x, each.y, each.z) for each in arrow.points]
        assert ends[0] == (5.0, 2.0, 3.0) and ends[1] == pytest.approx((4.5, 3.0, 3.25)), "forward is north, at its yaw"
        (told,) = until(lambda: diagnostics.take(1), "diagnostics")
        assert told.status[0].message == f"flying: {flying.status.sentence}"
        soon = replace(flying, time=flying.time + 0.1, status=replace(flying.status, changed=False, setpoint=None))
        reports.tell(soon)
        (drawn,) = until(lambda: markers.take(1), "the next markers")
        assert drawn.markers[2].action == 2, "without a set-point its arrow is taken away"
        reports.tell(replace(soon, time=flying.time + 1.0, pose=None, distance=7.0))
        (told,) = until(lambda: diagnostics.take(1), "the next diagnostics, a second later")
        assert {pair.key: pair.value for pair in told.status[0].values}["distance to the goal, m"] == "7.000"
