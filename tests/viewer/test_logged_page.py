"""The page of a real flight's log: its numbers are the log's, and what no log knows is not in it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from scipy.spatial.transform import Rotation

from tests.helpers.logged import GOAL, SILENT, START, WALLS, contract, cycles, write_log
from tests.helpers.pages import unpack
from uavrl.envs.lidar import Lidar
from uavrl.envs.simulation import Simulation
from uavrl.errors import UavrlError
from uavrl.sitl.faults import POSE
from uavrl.sitl.live import Motion
from uavrl.sitl.simulated_autopilot import SimulatedAutopilot
from uavrl.sitl.telemetry import Telemetry
from uavrl.viewer import logged_page
from uavrl.viewer.logged_page import logged_page_data
from uavrl_onboard.autopilot.vehicle_state import AutopilotMonitor
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.log import FlightLog
from uavrl_onboard.flight.logged_flight import LoggedFlight
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.mesh import Mesh


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[FlightCycle]]:
    return write_log(tmp_path_factory.mktemp("log") / "flight.mcap")


@pytest.fixture(scope="module")
def data(log: tuple[Path, list[FlightCycle]]) -> dict[str, Any]:
    return logged_page_data(LoggedFlight(log[0]), points=500)


def test_the_numbers_in_the_page_are_those_of_the_log(
    data: dict[str, Any], log: tuple[Path, list[FlightCycle]]
) -> None:
    shown = [cycle for cycle in log[1] if cycle.pose is not None]
    (flight,) = data["flights"]
    assert len(shown) == 57 and flight["steps"] == 56 and flight["outcome"] == "arrived"
    np.testing.assert_allclose(unpack(flight["times"]), 0.1 * np.arange(57), atol=1e-5)
    np.testing.assert_allclose(unpack(flight["positions"]), [c.pose.position for c in shown if c.pose], rtol=1e-6)
    np.testing.assert_allclose(unpack(flight["distances"]), [c.distance for c in shown], rtol=1e-6)
    np.testing.assert_allclose(unpack(flight["actions"]), [c.action for c in shown], rtol=1e-6)
    nothing = np.full(4, np.nan)
    sent = [nothing if c.status.setpoint is None else c.status.setpoint for c in shown]
    np.testing.assert_allclose(unpack(flight["setpoints"]), sent, rtol=1e-6)
    told = [flight["told"][at] for at in unpack(flight["told_at"])]
    assert told == [(c.status.state, c.status.reason, c.status.sentence, c.control.sentence) for c in shown]
    assert set(data["states"]) >= {state for state, *_ in told} >= {"silent", "standby", "flying", "holding"}
    assert flight["facts"]["time"] == "5.6 s" and flight["facts"]["at the goal after"] == "4.7 s"
    towards = np.subtract(GOAL[:2], [c.pose.position[:2] for c in shown if c.pose])
    turns = unpack(flight["bearings"]) - np.arctan2(towards[:, 1], towards[:, 0])
    asked = [at for at, cycle in enumerate(shown) if cycle.turn is not None]
    np.testing.assert_allclose(turns[asked], [shown[at].turn for at in asked], atol=1e-6)
    fresh, stale = SILENT[0] - 3, SILENT[0] - 3 + 3
    assert turns[[fresh, stale]] == pytest.approx([shown[fresh - 1].turn, 0.0], abs=1e-6), "as the scan it flies by"
    for name in ("rewards", "clearances", "planes", "position_stats", "path_efficiency"):
        assert name not in flight, "no log knows it"


def test_without_a_memory_the_page_tells_of_none(tmp_path: Path) -> None:
    with FlightLog(tmp_path / "f.mcap", contract(), GOAL, clock=lambda: START) as log:
        for cycle in cycles(10):
            log.write(replace(cycle, turn=None))
    assert "bearings" not in logged_page_data(LoggedFlight(log.path))["flights"][0]


def test_cells_and_points_are_shown_while_the_scan_is_one_to_fly_by(
    data: dict[str, Any], log: tuple[Path, list[FlightCycle]]
) -> None:
    shown = [cycle for cycle in log[1] if cycle.pose is not None]
    (flight,) = data["flights"]
    faces, ends = unpack(flight["faces"]), unpack(flight["point_ends"])
    counts = np.diff(ends, prepend=0)
    for moment, cycle in enumerate(shown):
        if cycle.cells is not None:
            np.testing.assert_array_equal(faces[moment], cycle.cells)
            assert 0 < counts[moment] <= 500
    fresh, stale = SILENT[0] - 3, SILENT[0] - 3 + 3
    np.testing.assert_array_equal(faces[fresh], faces[fresh - 1])
    assert not faces[stale : SILENT[1] - 3].any() and not counts[stale : SILENT[1] - 3].any()
    assert np.isnan(unpack(flight["nearest"])[stale])


def test_the_world_is_what_the_scans_saw_where_the_vehicle_was(data: dict[str, Any]) -> None:
    place = data["sceneries"]["log"]
    world = unpack(place["world"])
    assert len(world) > 1000
    off = np.minimum(np.abs(np.abs(world[:, 1]) - WALLS), np.abs(world[:, 2]))
    assert off.max() < 1e-4, "each point lies on a wall or on the ground, of a vehicle that is not level"
    low, high = np.array(place["box"]).T
    assert (world > low).all() and (world < high).all() and (low < GOAL).all() and (high > GOAL).all()
    assert unpack(place["goal"]).tolist() == [1.0, 5.0] and "heights" not in place
    assert place["ball"] == contract().cells.radius and place["statistic"] == contract().cells.statistic


def turned(attitude: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_quat(attitude).apply(points))


def test_a_simulated_vehicle_that_tilts_sees_a_wall_where_it_is(tmp_path: Path) -> None:
    """From the simulator by MAVLink's telemetry into the log, and from the log to what the page draws."""
    wall = Mesh([[8, -30, 0], [8, 30, 0], [8, 30, 30], [8, -30, 30]], [[0, 1, 2], [0, 2, 3]])  # x = 8
    tilts = log_a_flight_at(wall, tmp_path / "flight.mcap")
    assert max(tilts) > 0.2, "rad: it accelerates and brakes"
    data = logged_page_data(LoggedFlight(tmp_path / "flight.mcap"))
    world = unpack(data["sceneries"]["log"]["world"])
    assert len(world) > 200 and np.abs(world[:, 0] - 8.0).max() < 0.002
    (flight,) = data["flights"]
    assert flight["notes"] == []
    ends, points = unpack(flight["point_ends"]), unpack(flight["points"])
    sensor = unpack(data["sceneries"]["log"]["sensor"])
    level = []
    for moment, cloud in enumerate(np.split(points, ends[:-1])):
        position, attitude = unpack(flight["positions"])[moment], unpack(flight["attitudes"])[moment]
        drawn = turned(attitude, cloud + sensor) + position  # as drawing.js places them
        assert np.abs(drawn[:, 0] - 8.0).max() < 0.005
        _, _, z = Rotation.from_quat(attitude).as_euler("xyz")
        level.append(
            np.abs(
                (turned(np.array([0, 0, np.sin(z / 2), np.cos(z / 2)]), cloud + sensor) + position)[:, 0] - 8.0
            ).max()
        )
    assert max(level) > 0.3, "m: a level drawing would put the wall elsewhere"


def log_a_flight_at(wall: Mesh, path: Path) -> list[float]:
    """Logs a simulated flight with sharp turns of the command, and gives how far the vehicle tilted, in rad."""
    simulation, lidar = Simulation([wall], 1), Lidar([wall])
    telemetry, vehicle = Telemetry(common, SimulatedAutopilot(common, "px4")), AutopilotMonitor()
    sensor, tilts = contract().cloud.sensor_position, []
    np.testing.assert_array_equal(simulation.airframe.lidar_position, sensor)
    simulation.reset(np.array([0]), np.array([[2.0, 0.0, 8.0]]), np.array([0.4]))
    template = list(cycles(4))[3]
    with FlightLog(path, contract(), GOAL, clock=lambda: START) as log:
        for number in range(12):
            simulation.step(np.array([[2.0, -2.0, 0.0, 0.5] if number // 4 % 2 == 0 else [-2.0, 2.0, 0.0, 0.5]]))
            now = START + 0.1 * number
            rotation = simulation.rotation[0]
            motion = Motion(simulation.position[0], simulation.velocity[0], rotation, simulation.angular_velocity[0])
            for kind in (0, *POSE):
                message = telemetry.message(kind, now, motion)
                message._header = common.MAVLink_header(message.id, srcSystem=1, srcComponent=1)
                vehicle.hear(message, now)
            points = simulation.scan(lidar, np.array([0]), None, np.random.default_rng(0))[0]
            scan = Scan(now, points, len(points), int(np.isnan(points[:, 0]).sum()))
            log.write(replace(template, time=now, scan=scan, cells=None, pose=vehicle.pose()))
            tilts.append(math.acos(rotation[2, 2]))
    simulation.close()
    return tilts


def test_a_cut_log_and_missing_cycles_are_told(log: tuple[Path, list[FlightCycle]], tmp_path: Path) -> None:
    content = log[0].read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    (flight,) = logged_page_data(LoggedFlight(tmp_path / "cut.mcap"))["flights"]
    assert flight["outcome"] == "ended"
    assert flight["notes"] == ["The log ends in the middle: what came after is not in it."]


def test_a_long_log_keeps_fewer_points_and_one_that_is_too_long_is_refused(
    log: tuple[Path, list[FlightCycle]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logged_page, "MOST_POINTS", 5000)
    moments = logged_page.LoggedMoments(LoggedFlight(log[0]), 1500)
    assert 1000 < sum(map(len, moments.clouds)) <= 5000
    monkeypatch.setattr(logged_page, "MOST_CYCLES", 20)
    with pytest.raises(UavrlError, match="more than 20 cycles, too many for a page: open it in Foxglove"):
        logged_page_data(LoggedFlight(log[0]))


def test_a_log_without_a_pose_is_refused(tmp_path: Path) -> None:
    with FlightLog(tmp_path / "f.mcap", contract(), GOAL) as log:
        pass
    with pytest.raises(UavrlError, match="holds no cycle with a pose"):
        logged_page_data(LoggedFlight(log.path))
