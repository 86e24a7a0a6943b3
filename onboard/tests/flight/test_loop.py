"""The loop from scans to set-points, on a clock, a sensor, a policy and a vehicle of the test's own."""

from __future__ import annotations

import logging
import math
import socket
import time
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.helpers.ports import free_ports

from uavrl_onboard.autopilot.dry_run import DryRun
from uavrl_onboard.autopilot.frames import Pose, Vector
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.loop import Flight, fly, rehearse
from uavrl_onboard.flight.safety import Reason, SafetyLayer, SafetyState
from uavrl_onboard.flight.summary import FlightSummary
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.settings import GuardSettings, guard_settings
from uavrl_onboard.guards.shield import Shield
from uavrl_onboard.lidar.mount import mount_rotation
from uavrl_onboard.lidar.packets import encode_scan
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.lidar.udp_scans import UdpScans
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.vehicle import Vehicle

GOAL = (20.0, 0.0, 2.5)
VELOCITY = (0.75, -0.25, 0.125)  # so slow that a vehicle may drift as much without being believed less


class Policy:
    """Answers each scan with the same action, and notes what it was given."""

    def __init__(self, action: Sequence[float] = (1.0, 0.5, 0.0, 0.25)) -> None:
        self.contract = SimpleNamespace(
            rate_hz=10.0,
            flight_level=3.5,
            vehicle=Vehicle(),
            guard_settings=GuardSettings(),
            cloud=SimpleNamespace(lidar=None),
        )
        self.cells: np.ndarray | None = None
        self.last_action = np.zeros(4, np.float32)
        self.action, self.seen, self.before = np.array(action, np.float32), list[tuple[Any, ...]](), list[list[float]]()
        self.own = list[tuple[Any, ...]]()
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1
        self.last_action = np.zeros(4, np.float32)

    def __call__(
        self, cloud: np.ndarray, altitude: float, heading_deg: float, elevation_deg: float, *own: Vector | float | None
    ) -> np.ndarray:
        self.seen.append((cloud, altitude, heading_deg, elevation_deg))
        self.own.append(own)
        self.before.append(self.last_action.tolist())
        self.cells = np.full(72, float(len(cloud)))
        return self.action.copy()


class Link(DryRun):
    """A vehicle whose state and pose the test sets, and which keeps what it was sent."""

    def __init__(self) -> None:
        super().__init__((0.0, 0.0, 3.5))
        self.control, self.sent = Control.IN_CONTROL, list[tuple[float, ...] | None]()
        self.place: Vector | None = (0.0, 0.0, 3.5)
        self.velocity: Vector = VELOCITY

    def pose(self) -> Pose | None:  # type: ignore[override]
        return None if self.place is None else Pose(self._now, self.place, self.velocity, 0.0, 0.25, -0.125)

    def status(self, now: float) -> VehicleStatus:
        return VehicleStatus(self.control, "as the test says")

    def send(self, setpoint: Any, now: float) -> None:
        self.sent.append(setpoint)


class Rig:
    """A flight whose clock the test turns."""

    def __init__(self, policy: Policy | None = None, **options: Any) -> None:
        self.policy, self.link, self.now = policy or Policy(), Link(), 100.0
        self.flight = Flight(self.policy, GOAL, self.link, SafetyLayer(), **options)  # type: ignore[arg-type]

    def scan(self, points: Any = ((2.0, 0.0, 0.0),)) -> FlightCycle:
        """A tenth of a second later, with a scan."""
        self.now += 0.1
        self.link.receive(self.now)
        return self.flight.step(self.now, Scan(self.now, np.array(points, np.float32), 10, 0))

    def nothing(self) -> FlightCycle:
        """0.12 s later, without one."""
        self.now += 0.12
        self.link.receive(self.now)
        return self.flight.step(self.now, None)

    def airborne(self) -> FlightCycle:
        """The first cycle in which the policy flies."""
        for _ in range(20):
            if (cycle := self.scan()).status.state is SafetyState.FLYING:
                return cycle
        raise AssertionError("it never flew")


def guards(*names: str) -> Guards:
    """Guards of the default vehicle, by their names."""
    return Guards(guard_settings(list(names)))


def test_a_shield_slows_the_policy_before_what_the_scan_shows_near() -> None:
    """The policy asks for 1 m/s ahead; the vehicle flies 0.75 m/s to the east and 0.25 to the south, and is tilted."""
    shield, tilt, velocity = Shield(), (0.25, -0.125), np.array(VELOCITY)
    rig = Rig(guards=guards("shield"))
    rig.airborne()
    near = np.array([[0.9, 0.0, -0.2]])
    flown, asked = rig.scan(near).action, np.array([1.0, 0.5, 0.0])
    assert flown is not None
    assert flown[:3] == pytest.approx(shield(asked, near, tilt, velocity), abs=1e-6)
    assert flown[0] < 0.6 and flown[3] == 0.25
    free = rig.scan(np.full((1, 3), np.nan)).action
    assert free is not None and free.tolist() == [1.0, 0.5, 0.0, 0.25]


def test_a_policy_that_knows_of_nothing_keeps_out_of_the_way_of_what_moves() -> None:
    """A ball comes straight ahead at 3 m/s; before the shield has its say, the evasion has chosen another velocity."""
    evading, plain = Rig(guards=guards("evasion", "shield")), Rig(guards=guards("shield"))
    ring = np.linspace(-0.15, 0.15, 5)
    ball = np.stack(np.broadcast_arrays(9.0, ring[:, None], ring), -1).reshape(-1, 3)
    for rig in (evading, plain):
        rig.link.pose = lambda now=rig: Pose(now.now, (0.0, 0.0, 3.5), (0.0, 0.0, 0.0), 0.0)  # type: ignore[method-assign]
        rig.airborne()
        flown = [rig.scan(ball - [0.3 * step, 0.0, 0.0]).action for step in range(10)]
        assert flown[0] is not None and flown[0].tolist() == [1.0, 0.5, 0.0, 0.25], "seen once, it does not move"
        assert flown[-1] is not None and flown[-1][3] == 0.25
        gave_way = float(np.linalg.norm(flown[-1][:3] - [1.0, 0.5, 0.0])) > 0.3
        assert gave_way == (rig is evading)


def test_with_a_map_the_policy_reads_the_heading_to_the_way_around_what_was_seen() -> None:
    """A wall of 4 m stands 2 m ahead; the goal is 20 m ahead, and once the wall is out of sight it is remembered."""
    wall = np.stack(np.broadcast_arrays(2.0, np.linspace(-1.0, 3.0, 40), -0.1), -1)
    rig, without = Rig(guards=guards("map")), Rig()
    for each in (rig, without):
        each.link.pose = lambda now=each: Pose(now.now, (0.0, 0.0, 3.5), (0.0, 0.0, 0.0), 0.0)  # type: ignore[method-assign]
        each.scan(wall)
        each.airborne()
        each.scan(np.full((1, 3), np.nan))
    heading = rig.policy.seen[-1][2]
    assert 290.0 < heading < 340.0, "to the right of the wall"
    assert without.policy.seen[-1][2] == 0.0
    assert rig.policy.seen[-1][3] == without.policy.seen[-1][3], "the elevation is the goal's"


@pytest.mark.parametrize("name", ["shield", "evasion"])
def test_without_the_vehicles_velocity_they_let_nothing_pass(name: str, caplog: pytest.LogCaptureFixture) -> None:
    rig, told = Rig(guards=guards(name)), f"Guards ({name}) need finite numbers, got"
    rig.airborne()
    rig.link.pose = lambda: Pose(rig.now, (0.0, 0.0, 3.5), (np.nan, 0.0, 0.0), 0.0)  # type: ignore[method-assign]
    assert rig.scan().action is None
    assert told in caplog.text


def test_a_scan_becomes_a_setpoint() -> None:
    rig = Rig()
    cycle = rig.airborne()
    assert cycle.status.setpoint == (1.0, 0.5, 0.0, 0.25) == rig.link.sent[-1]
    cloud, altitude, heading, elevation = rig.policy.seen[-1]
    assert cloud.tolist() == [[2.0, 0.0, 0.0]]
    assert (altitude, heading) == (3.5, 0.0)
    assert rig.policy.own[-1] == (VELOCITY, (0.25, -0.125, 0.0), None), "velocity, and roll, pitch and yaw"
    assert elevation == pytest.approx(360.0 - math.degrees(math.atan2(1.0, 20.0)), abs=1e-4)
    assert cycle.cells is not None and cycle.cells.tolist() == [1.0] * 72
    assert (cycle.distance, cycle.arrived, cycle.control.control) == (20.0, False, Control.IN_CONTROL)
    assert cycle.latency is not None and 0.0 < cycle.latency < 5.0
    assert cycle.scan is not None and cycle.scan.stamp == cycle.time


def test_until_it_flies_each_scan_is_the_first_of_an_episode_and_then_its_last_action_is_what_was_sent() -> None:
    rig = Rig(Policy((2.0, 0.0, 0.0, 0.0)))
    rig.link.control = Control.OTHER_MODE
    for _ in range(15):
        assert rig.scan().status.setpoint in (None, (0.0, 0.0, 0.0, 0.0))
    assert rig.policy.resets == 15 and rig.policy.before == [[0.0] * 4] * 15
    rig.link.control = Control.IN_CONTROL
    rig.policy.action = np.array([5.0, 0.0, 0.0, 0.0], np.float32)
    assert rig.scan().status.setpoint == pytest.approx((2.0, 0.0, 0.0, 0.0)), "clipped"
    rig.scan()
    assert rig.policy.resets == 16 and rig.policy.before[-1] == [2.0, 0.0, 0.0, 0.0]


def test_a_policy_is_told_how_long_after_the_last_scan_that_it_read_another_one_comes() -> None:
    rig = Rig()
    rig.airborne()
    rig.scan()
    rig.nothing()
    rig.scan()
    rig.link.place = None
    rig.scan()
    rig.link.place = (0.0, 0.0, 3.5)
    rig.scan()
    told = [own[-1] for own in rig.policy.own[-4:]]
    assert told == [None, pytest.approx(0.1), pytest.approx(0.22), None], "without a pose it has begun anew"


def test_points_on_the_vehicle_are_not_seen() -> None:
    rig = Rig(box=(np.full(3, -0.4), np.full(3, 0.4)))
    cycle = rig.scan([(0.2, 0.0, -0.3), (2.0, 0.0, 0.0)])
    assert cycle.scan is not None and cycle.scan.points.tolist() == [[2.0, 0.0, 0.0]]
    assert rig.policy.seen[-1][0].tolist() == [[2.0, 0.0, 0.0]]


def test_the_points_of_a_lidar_that_is_mounted_otherwise_are_turned_first() -> None:
    box = np.array([-0.4, -0.4, -0.4]), np.array([0.4, 0.4, 0.1])
    rig = Rig(rotation=mount_rotation((180.0, 0.0, 90.0)), box=box)
    cycle = rig.scan([(0.2, 0.0, 0.3), (0.2, 0.0, -0.3), (2.0, 1.0, 0.5)])  # the first one is on the vehicle
    expected = [[0.0, 0.2, 0.3], [1.0, 2.0, -0.5]]
    assert cycle.scan is not None
    np.testing.assert_allclose(cycle.scan.points, expected, atol=1e-6)
    np.testing.assert_allclose(rig.policy.seen[-1][0], expected, atol=1e-6)


@pytest.mark.parametrize(("rate", "acts"), [(20.0, 10.0), (10.0, 10.0), (9.0, 9.0)])
def test_the_policy_acts_at_its_own_rate(rate: float, acts: float) -> None:
    rig = Rig()
    scans = [Scan(number / rate, np.ones((1, 3), np.float32), 1, 0) for number in range(int(2 * rate) + 1)]
    cycles = list(rehearse(rig.flight, scans, rig.link))
    assert len(cycles) == len(rig.policy.seen) == 2 * acts + 1


def test_a_sensor_that_falls_silent_stops_the_vehicle_and_then_the_stream() -> None:
    rig = Rig()
    rig.airborne()
    states = [rig.nothing().status for _ in range(8)]
    assert [status.state for status in states[:2]] == [SafetyState.FLYING, SafetyState.HOLDING]
    assert states[1].reason is Reason.OLD_SCAN and states[1].setpoint == (0.0, 0.0, 0.0, 0.0)
    assert states[-1].state is SafetyState.SILENT and rig.link.sent[-1] is None
    calls, resets = len(rig.policy.seen), rig.policy.resets
    assert rig.scan().status.state is SafetyState.SILENT, "first all must be well for a second"
    assert len(rig.policy.seen) == calls + 1 and rig.policy.resets == resets + 1


def test_a_scan_without_a_pose_gives_no_action() -> None:
    rig = Rig()
    rig.link.place = None
    cycle = rig.scan()
    assert (cycle.status.reason, cycle.action, cycle.distance, rig.policy.seen) == (Reason.NO_POSE, None, None, [])
    rig.link.place = (math.nan, 0.0, 3.5)
    assert rig.scan().status.reason is Reason.POSE_NOT_FINITE and not rig.policy.seen
    rig.link.place = (0.0, 0.0, 3.5)
    assert rig.airborne().action is not None


def test_a_policy_that_fails_stops_the_vehicle_and_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig()
    rig.airborne()

    def fail(*_: Any) -> np.ndarray:
        raise UavrlError("policy.onnx answers with numbers that are not finite: do not fly it.")

    rig.flight._policy = fail  # type: ignore[assignment]
    fail.reset, fail.last_action, fail.cells = (lambda: None), None, None  # type: ignore[attr-defined]
    with caplog.at_level(logging.WARNING):
        first, second = rig.scan().status, rig.scan().status
    assert (first.state, first.reason, first.setpoint) == (SafetyState.HOLDING, Reason.NO_ACTION, (0.0, 0.0, 0.0, 0.0))
    assert second.state is SafetyState.HOLDING
    assert [record.getMessage() for record in caplog.records] == [
        "The policy gives no action: policy.onnx answers with numbers that are not finite: do not fly it."
    ]


def test_at_the_goal_it_hovers() -> None:
    rig = Rig()
    rig.link.control, rig.link.place, rig.link.velocity = Control.OTHER_MODE, (19.3, 0.3, 3.5), (0.0, 0.0, 0.0)
    for _ in range(15):
        assert not rig.scan().arrived, "the policy did not fly there"
    rig.link.control, rig.link.place = Control.IN_CONTROL, (18.9, 0.0, 3.5)
    assert not rig.scan().arrived
    rig.link.place = (19.1, 0.0, 3.9)
    cycle = rig.scan()
    assert not cycle.arrived and cycle.status.setpoint == (0.0, 0.0, 0.0, 0.0), "from this moment on"
    rig.link.place = (18.9, 0.0, 3.9)
    cycle = rig.scan()
    assert not cycle.arrived and cycle.status.setpoint == (1.0, 0.5, 0.0, 0.25), "it was there for one pose alone"
    rig.link.place = (19.1, 0.0, 3.9)
    assert [rig.scan().arrived for _ in range(3)] == [False, False, True]
    rig.link.place = (18.8, 0.0, 3.5)
    cycle = rig.scan()
    assert cycle.arrived and cycle.status.setpoint == (0.0, 0.0, 0.0, 0.0) and cycle.status.state is SafetyState.FLYING
    assert rig.flight.arrived == pytest.approx(rig.now - 0.1)


def test_a_goal_where_it_is_moves_it_nowhere() -> None:
    rig = Rig(Policy((2.0, 0.0, 0.0, 1.0)))
    rig.link.place = GOAL
    rig.airborne()
    rig.scan()
    assert rig.scan().arrived
    assert set(rig.link.sent) == {None, (0.0, 0.0, 0.0, 0.0)}


def test_who_flies_is_told_when_it_changes(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig()
    with caplog.at_level(logging.INFO):
        rig.scan(), rig.scan()
        rig.link.control = Control.TAKEN_OVER
        rig.scan(), rig.scan()
    assert [record.getMessage() for record in caplog.records] == [
        "Vehicle: in_control (as the test says)",
        "Vehicle: taken_over (as the test says)",
    ]


@pytest.mark.parametrize("goal", [(1.0, 2.0), (1.0, 2.0, math.nan)])
def test_a_goal_is_three_finite_numbers(goal: tuple[float, ...]) -> None:
    with pytest.raises(UavrlError, match="goal must be three finite numbers"):
        Flight(Policy(), goal, Link(), SafetyLayer())  # type: ignore[arg-type]


def packets(distance: float = 3.0, stamp: float = 0.0) -> list[bytes]:
    return encode_scan(distance * firing_directions(), stamp=stamp)


def sender(host: str) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind((host, 0))
    return opened


def test_a_sensor_on_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    port, _ = free_ports()
    feed = UdpScans(f"udp://127.0.0.1:{port}", "VLP16")
    assert feed.trouble().startswith("no packet arrived")
    with sender("127.0.0.1") as sensor:
        begun, address = time.monotonic(), "{}:{}".format(*sensor.getsockname())
        for packet in packets():
            sensor.sendto(packet, ("127.0.0.1", port))
        scan = feed.poll(time.monotonic())
        assert scan is not None and begun <= scan.stamp <= time.monotonic()
        assert np.sqrt((scan.points**2).sum(-1)).max() == pytest.approx(3.0, abs=0.002)
        assert feed.poll(time.monotonic()) is None
        assert "no full turn" in feed.trouble()
        later = time.monotonic() + 5.0
        monkeypatch.setattr(time, "monotonic", lambda: later)
        assert feed.trouble().startswith(f"no packet of {address}, which had sent before, has come for 5 s: look at")
    feed.close()


def test_a_second_sensor_on_the_port_is_left_out() -> None:
    port, _ = free_ports()
    feed = UdpScans(f"udp://127.0.0.1:{port}", "VLP16")
    with sender("127.0.0.1") as ours, sender("127.0.0.2") as other:
        for near, far in zip(packets(2.0), packets(9.0), strict=True):
            ours.sendto(near, ("127.0.0.1", port))
            other.sendto(far, ("127.0.0.1", port))
        scan = feed.poll(time.monotonic())
        assert scan is not None and np.sqrt((scan.points**2).sum(-1)).max() == pytest.approx(2.0, abs=0.002)
        assert feed.skipped.other_sender == 76
    feed.close()


def test_in_real_time_there_are_cycles_with_and_without_a_scan() -> None:
    rig = Rig()

    class Feed:
        def __init__(self) -> None:
            self.given = 0

        def poll(self, now: float) -> Scan | None:
            if self.given:
                return None
            self.given += 1
            return Scan(now, np.ones((1, 3), np.float32), 1, 0)

        def fileno(self) -> None:
            return None

        def close(self) -> None:
            pass

    cycles = fly(rig.flight, Feed(), rig.link)
    first, second, third = next(cycles), next(cycles), next(cycles)
    assert first.scan is not None and second.scan is None is third.scan
    assert second.time - first.time >= 0.12 and third.time - second.time >= 0.12
    assert second.status.scan_age is not None and second.status.scan_age >= 0.12


def test_the_numbers_of_a_flight() -> None:
    rig, summary = Rig(), FlightSummary()
    rig.link.place = (18.9, 0.0, 3.5)
    for _ in range(12):
        summary.add(rig.scan())
    rig.link.place = (19.5, 0.0, 3.5)
    for _ in range(3):
        summary.add(rig.scan())
    facts = summary.facts()
    assert (facts["arrived"], facts["arrived_after_s"], facts["least_distance_m"]) == (True, 1.4, 0.5)
    assert (facts["cycles"], facts["scans"], facts["seconds"]) == (15, 15, 1.4)
    assert facts["cycles_in_state"] == {"silent": 10, "standby": 1, "flying": 4}
    assert [change[1:3] for change in facts["changes"]] == [
        ["silent", "settling"],
        ["standby", "settling"],
        ["flying", "in_control"],
    ]
    assert 0.0 < facts["latency_ms"]["median"] <= facts["latency_ms"]["p99"]
    assert summary.rate == pytest.approx(10.0)
    assert FlightSummary().facts()["latency_ms"] == {"median": None, "p99": None}
