"""Scans that cover less than their sensor sees, and open terrain, which looks similar."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from onboard.tests.flight.test_loop import Rig

from uavrl_onboard.flight.safety import Reason, SafetyState
from uavrl_onboard.geometry import Columns
from uavrl_onboard.lidar.coverage import EMPTY, WATCHED, Coverage, Doubt, degrees_of
from uavrl_onboard.lidar.mount import mount_rotation
from uavrl_onboard.lidar.vlp16 import firing_directions

AZIMUTHS = np.radians(np.arange(0.1, 360.0, 0.4))


def ring(ranges: np.ndarray | float = 3.0) -> np.ndarray:
    """Points around the sensor, none where the range is infinite."""
    far = np.broadcast_to(ranges, AZIMUTHS.shape)
    points = np.stack([far * np.cos(AZIMUTHS), far * np.sin(AZIMUTHS), np.full_like(AZIMUTHS, -0.2)], -1)
    return points[np.isfinite(far)].astype(np.float32)


ROOM = ring(2.0 + np.cos(AZIMUTHS) ** 2 * 4.0)


def cut(low: float, high: float, points: np.ndarray = ROOM) -> np.ndarray:
    """Without what lies between two directions, in degrees."""
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
    return points[(azimuth < low) | (azimuth > high)]


def looked(scans: Iterable[np.ndarray], yaw: Callable[[int], float] = lambda number: 0.0) -> list[Doubt | None]:
    coverage = Coverage()
    return [coverage.add(points, yaw(number)) for number, points in enumerate(scans)]


@pytest.mark.parametrize("empty", [np.zeros((0, 3)), np.zeros((50, 3)), np.full((50, 3), np.nan)])
def test_scans_without_a_return_are_doubted_after_a_second(empty: np.ndarray) -> None:
    found = looked([ROOM] * 5 + [empty] * 15 + [ROOM])
    assert not any(found[: 5 + EMPTY - 1]) and all(found[5 + EMPTY - 1 : 20]) and found[20] is None
    assert found[14] == (
        "empty_scans",
        "10 scans in a row hold no return at all: is the sensor covered, its laser off, or its driver's range too "
        "short?",
        True,
    )


@pytest.mark.parametrize(
    ("low", "high", "certain"),
    [(90.0, 270.0, True), (180.0, 360.0, True), (90.0, 180.0, True), (100.0, 265.0, False), (150.0, 210.0, False)],
)
def test_a_window_is_doubted_from_the_start(low: float, high: float, certain: bool) -> None:
    found = looked([cut(low, high)] * 30)
    assert not any(found[: WATCHED - 1]) and all(found[WATCHED - 1 :])
    last = found[-1]
    assert last is not None and (last.kind, last.certain) == ("half_scan", certain)
    assert f"no return has ever come from {low:.0f}° to {high % 360:.0f}° (0° is ahead, 90° left)" in last.sentence
    assert ("is nothing in range there" in last.sentence) is not certain


def test_a_window_turns_with_the_sensor_and_is_certain_then() -> None:
    found = looked([cut(100.0, 265.0)] * 60, lambda number: math.radians(number))
    assert [doubt.certain for doubt in found if doubt is not None] == [False] + [True] * 40


def test_open_terrain_does_not_turn_with_the_sensor() -> None:
    scans = []
    for number in range(300):
        yaw = math.radians(40.0 * math.sin(0.1 * number))
        direction = (AZIMUTHS + yaw) % math.tau  # in the world, where everything between 100° and 265° is far
        scans.append(ring(np.where((direction > math.radians(100)) & (direction < math.radians(265)), np.inf, 3.0)))
    found = looked(scans, lambda number: math.radians(40.0 * math.sin(0.1 * number)))
    assert not any(doubt is not None and doubt.certain for doubt in found)


@pytest.mark.parametrize("far", [6.0, 12.0])
def test_a_wall_that_goes_out_of_range_is_no_fault(far: float) -> None:
    """The vehicle flies away from a long wall behind it, beside another one, with a driver's range of ``far``."""
    scans = []
    for number in range(100):
        away = 2.0 + 0.2 * number
        with np.errstate(divide="ignore"):
            behind = np.where(np.cos(AZIMUTHS) < 0, -away / np.cos(AZIMUTHS), np.inf)
            beside = np.where(np.sin(AZIMUTHS) > 0, 2.0 / np.sin(AZIMUTHS), np.inf)
        ranges = np.minimum(behind, beside)
        scans.append(ring(np.where(ranges < far, ranges, np.inf)))
    assert not any(doubt is not None and doubt.certain for doubt in looked(scans))


def test_the_ground_that_goes_out_of_range_is_no_fault() -> None:
    """A ring of returns from the ground at the very end of a driver's range, which half of the circle loses."""
    ground = ring(11.6)
    assert not any(doubt is not None and doubt.certain for doubt in looked([ground] * 20 + [cut(95, 270, ground)] * 40))


def test_half_of_the_scans_that_ceases_at_once_is_certain() -> None:
    found = looked([ROOM] * 15 + [cut(80.0, 250.0)] * 15 + [ROOM])
    assert not any(found[:24]) and all(found[25:30]) and found[30] is None
    assert found[25] is not None and found[25].certain
    assert found[25].sentence.startswith("no return has come from 80° to 250° (0° is ahead, 90° left) for 1")


@pytest.mark.parametrize("points", [np.array([[3.0, 0.0, 0.0]]), ROOM[:200], ROOM[::8]], ids=["one", "arc", "sparse"])
def test_few_or_narrow_scans_are_not_judged(points: np.ndarray) -> None:
    assert not any(doubt is not None and doubt.certain for doubt in looked([points] * 60))


def test_a_half_scan_stops_the_flight_and_names_the_reason() -> None:
    rig = Rig()
    states = [rig.scan(cut(90.0, 270.0)).status for _ in range(30)]
    assert SafetyState.FLYING in {status.state for status in states[:WATCHED]}
    stopped = states[WATCHED - 1]
    assert (stopped.state, stopped.reason) == (SafetyState.HOLDING, Reason.HALF_SCAN)
    assert stopped.sentence == (
        "no return has ever come from 90° to 270° (0° is ahead, 90° left): does the driver's window cut it off?"
    )
    assert states[-1].state is SafetyState.SILENT
    assert rig.nothing().status.reason is Reason.HALF_SCAN, "without a scan it is not over"


def test_a_window_that_may_be_open_terrain_is_told_and_flown() -> None:
    rig = Rig()
    cycles = [rig.scan(cut(100.0, 265.0)) for _ in range(30)]
    assert cycles[-1].status.state is SafetyState.FLYING
    assert cycles[-1].doubt is not None and "is nothing in range there, or does the driver's" in cycles[-1].doubt


def test_the_vehicle_s_own_parts_count_as_seen() -> None:
    behind = np.abs(np.degrees(AZIMUTHS) - 180.0) < 20.0
    mast = ring(np.where(behind, 0.5, 3.0))
    for points, doubted in ((mast, False), (cut(160.0, 200.0), True)):
        rig = Rig(box=(np.full(3, -0.7), np.full(3, 0.7)))
        cycles = [rig.scan(points) for _ in range(30)]
        assert (cycles[-1].doubt is not None) is doubted and cycles[-1].status.state is SafetyState.FLYING


def test_empty_scans_stop_the_flight() -> None:
    rig = Rig()
    rig.airborne()
    states = [rig.scan(np.zeros((0, 3))).status for _ in range(20)]
    assert states[8].state is SafetyState.FLYING
    assert (states[9].state, states[9].reason) == (SafetyState.HOLDING, Reason.EMPTY_SCANS)
    assert states[-1].state is SafetyState.SILENT


def test_what_lies_beside_a_narrow_field_of_view_is_not_missed() -> None:
    ahead = cut(44.0, 316.0)
    narrow, round_about = Coverage((-43.5, 43.5)), Coverage()
    assert not any(narrow.add(ahead, 0.0) for _ in range(30))
    assert round_about is not None and any(round_about.add(ahead, 0.0) for _ in range(30))
    nothing_to_the_left = ahead[np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0])) < 0.0]
    half = Coverage((-43.5, 43.5))
    doubts = [half.add(nothing_to_the_left, 0.0) for _ in range(30)]
    assert doubts[-1] is not None and doubts[-1].kind == "half_scan"


@pytest.mark.parametrize("unit", [1000.0, 1e6, 100.0])
def test_ranges_in_another_unit_are_certain(unit: float) -> None:
    """A room of 2 to 6 m, or in centimetres one of twenty times that size."""
    size = 20.0 if unit == 100.0 else 1.0
    found = looked([unit * size * ROOM] * 6)
    last = found[-1]
    assert not any(found[:4]) and last is not None and (last.kind, last.certain) == ("odd_ranges", True)
    assert last.sentence.endswith(
        "m, which no LiDAR measures: is its driver's unit millimetres? Points must be in metres"
    )


def test_one_range_in_all_directions_is_certain() -> None:
    heights = np.radians([-15.0, 0.0, 15.0])[:, None]
    around = np.stack(np.broadcast_arrays(np.cos(AZIMUTHS), np.sin(AZIMUTHS), np.tan(heights)), -1).reshape(-1, 3)
    sphere = around / np.linalg.norm(around, axis=1)[:, None]
    last = looked([50.0 * sphere] * 6)[-1]
    assert last is not None and last.kind == "odd_ranges"
    assert last.sentence.startswith("all returns are 50.0 m away in every direction: is the sensor covered, or does")
    assert not any(looked([3.0 * sphere] * 6)), "what is near is an obstacle"
    assert not any(looked([np.concatenate([50.0 * sphere, ROOM])] * 6)), "a driver that writes its range for a miss"
    assert not any(looked([ring(50.0)] * 6)), "the ground, by one beam"


@pytest.mark.parametrize("parts", [2, 3, 10])
def test_scans_of_a_part_of_a_turn_each_are_certain(parts: int) -> None:
    wide, azimuth = 360.0 / parts, np.degrees(np.arctan2(ROOM[:, 1], ROOM[:, 0])) % 360.0
    far = np.array([[20.0, 0.0, 0.0]])  # a return of another building, in each
    scans = [np.concatenate([ROOM[(azimuth - wide * number) % 360.0 < wide], far]) for number in range(40)]
    last = looked(scans)[-1]
    assert last is not None and (last.kind, last.certain) == ("half_scan", True)
    assert last.sentence.startswith("each scan shows another part of the surroundings: does the driver publish a part")


def test_trunks_that_pass_are_no_parts_of_a_turn() -> None:
    """A vehicle at 2 m/s among trunks, with one far wall."""
    rng, scans = np.random.default_rng(0), []
    trunks = np.c_[rng.uniform(-5, 60, 60), rng.uniform(-10, 10, 60)]
    for number in range(200):
        to = trunks - [0.2 * number, 0.0]
        middle, far = np.arctan2(to[:, 1], to[:, 0]), np.linalg.norm(to, axis=1)
        turned = np.abs((AZIMUTHS[:, None] - middle + np.pi) % (2 * np.pi) - np.pi)
        ranges = np.where(turned < np.arcsin(np.minimum(0.3 / far, 1.0)), far, np.inf).min(1)
        scans.append(ring(np.minimum(ranges, 30.0)))
    assert not any(doubt is not None and doubt.certain for doubt in looked(scans))


def test_a_return_counts_in_its_degree_also_next_to_a_border() -> None:
    """Where single precision rounds to the wrong side of a border, double precision decides."""
    borders, beside = np.radians(np.arange(-180.0, 181.0)), np.array([0.0, 1e-9, -1e-9, 1e-6, -1e-6, 1e-3, -1e-3, 5e-3])
    azimuth = np.append((borders[:, None] + beside).ravel(), np.random.default_rng(0).uniform(-np.pi, np.pi, 10_000))
    points = (7.0 * np.stack([np.cos(azimuth), np.sin(azimuth), 0.1 * azimuth], -1)).astype(np.float32)
    x, y = points[:, :2].T.astype(np.float64)
    exact = np.floor(np.degrees(np.arctan2(y, x))).astype(int) % 360
    assert degrees_of(Columns.of(points)).tolist() == exact.tolist()
    assert (np.floor(np.degrees(np.arctan2(*points[:, 1::-1].T))).astype(int) % 360 != exact).any()


SEEN = (-15.0, 15.0)


def layer(elevation_deg: float, spread_deg: float = 0.0) -> np.ndarray:
    """Walls at 2 to 6 m, seen at one elevation, or at some."""
    far = 2.0 + 4.0 * np.cos(AZIMUTHS) ** 2
    elevation = np.radians(elevation_deg + spread_deg * np.linspace(-0.5, 0.5, len(far)))
    around = far * np.cos(elevation)
    return np.stack([around * np.cos(AZIMUTHS), around * np.sin(AZIMUTHS), far * np.sin(elevation)], -1)


@pytest.mark.parametrize(
    ("scan", "seen", "doubted"),
    [
        (layer(0.0), SEEN, True),
        (layer(-1.0, 0.5), SEEN, True),
        (layer(0.0), (-7.0, 52.0), True),
        (layer(0.0), (0.0, 0.0), False),
        (layer(0.0), None, False),
        (layer(0.0, 4.0), SEEN, False),
        (layer(-15.0), SEEN, False),  # the ground, where a driver's range lets one beam alone reach it
    ],
)
def test_returns_at_one_elevation_are_those_of_a_single_layer(
    scan: np.ndarray, seen: tuple[float, float] | None, doubted: bool
) -> None:
    coverage = Coverage(elevations=seen)
    found = [coverage.add(scan) for _ in range(WATCHED + 5)]
    assert not any(found[: WATCHED - 1])
    if not doubted:
        assert not any(found)
        return
    last = found[-1]
    assert last is not None and (last.kind, last.certain) == ("half_scan", True)
    assert last.sentence.startswith("all returns lie at the same elevation, and the sensor should see from ")
    assert "is it a 2-D LiDAR (hull.elevations=[0,0])?" in last.sentence


@pytest.mark.parametrize("level", [True, False])
def test_open_ground_that_a_tilted_lidar_sees_on_one_side_is_no_window(level: bool) -> None:
    """A VLP-16 that is tilted forward by 20 degrees sees no ground behind it."""
    rays = firing_directions().astype(float) @ mount_rotation((0.0, 20.0, 0.0)).T
    down = rays[rays[:, 2] < -0.02]
    ground = down * (3.0 / -down[:, 2:])
    ground = ground[np.linalg.norm(ground, axis=1) < 30.0]
    coverage, yaw = Coverage(level=level), 0.0
    for _ in range(3 * WATCHED):
        doubt, yaw = coverage.add(ground, yaw), yaw + 0.05
    assert doubt is not None and doubt.certain == level
    assert ("is nothing in range there, or" in doubt.sentence) == (not level)


def test_a_single_scan_with_several_elevations_answers_for_good() -> None:
    coverage = Coverage(elevations=SEEN)
    assert not any(coverage.add(scan) for scan in [layer(0.0, 8.0)] + [layer(0.0)] * 40)
