"""A vehicle that knows its place and its goal, led by what it has seen."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from onboard.tests.guards.map.test_wayfinder import ALTITUDE, STILL, scanned, wall

from uavrl_onboard.guards.map import EpisodeMap, Navigator
from uavrl_onboard.guards.map.navigator import CIRCLES, ELSEWHERE, EVERY, WITHIN
from uavrl_onboard.guards.map.route import waypoint
from uavrl_onboard.vehicle import VEHICLE

GOAL, NOTHING = np.array([105.0, 50.0]), np.full((1, 3), np.nan)
START = np.array([100.0, 50.0, ALTITUDE])  # anywhere in the world's axes


def looked(navigator: Navigator, points: np.ndarray, place: np.ndarray = START, goal: np.ndarray = GOAL) -> float:
    """The turn after a scan of points given from the start on."""
    return navigator.look(scanned(points, place - START, STILL[0])[0], STILL[0], place, goal)


def test_what_stands_behind_the_goal_is_not_in_the_way() -> None:
    behind = wall((7.0, 3.0), (7.0, -1.0))
    assert looked(Navigator(), behind) == 0.0
    assert looked(Navigator(), behind, goal=GOAL + np.array([5.0, 0.0])) < -0.1


@pytest.mark.parametrize("yaw", [0.0, 2.0, -2.5])
def test_the_turn_is_from_the_goals_direction_whatever_the_head(yaw: float) -> None:
    attitude, points = np.array([0.0, 0.0, yaw]), wall((2.0, 3.0), (2.0, -1.0))
    turn = Navigator().look(scanned(points, np.zeros(3), attitude)[0], attitude, START, GOAL)
    assert turn == pytest.approx(looked(Navigator(), points), abs=0.1)
    assert -1.2 < turn < -0.4


def test_it_remembers_what_it_no_longer_sees() -> None:
    navigator = Navigator()
    turn = looked(navigator, wall((2.0, 3.0), (2.0, -1.0)))
    for _ in range(2 * EVERY):
        assert looked(navigator, NOTHING) == pytest.approx(turn, abs=1e-9)


def test_where_its_axes_have_moved_it_begins_a_new_map() -> None:
    navigator, points = Navigator(), wall((2.0, 3.0), (2.0, -1.0))
    first = looked(navigator, points)
    near, far = (START + np.array([0.0, share * ELSEWHERE, 0.0]) for share in (0.9, 2.0))
    assert looked(navigator, NOTHING, near) != 0.0 != first
    assert looked(navigator, NOTHING, far) == 0.0 and not len(navigator.known.occupied)


def test_a_jump_is_seen_also_of_a_place_that_is_moved_on_in_the_same_array() -> None:
    navigator, place = Navigator(), START.copy()
    looked(navigator, wall((2.0, 3.0), (2.0, -1.0)), place)
    assert len(navigator.known.occupied)
    place[0] += 2 * ELSEWHERE
    looked(navigator, NOTHING, place)
    assert not len(navigator.known.occupied)


def test_a_goal_far_away_is_looked_for_within_its_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole way to a goal 500 m away would take seconds to find, in which a vehicle flies on."""
    navigator, points, ends = Navigator(reach=20.0), wall((2.0, 3.0), (2.0, -1.0)), list[np.ndarray]()
    find, (east, north) = EpisodeMap.route, START[:2]

    def noted(known: EpisodeMap, place: np.ndarray, goal: np.ndarray) -> np.ndarray | None:
        ends.append(goal)
        return find(known, place, goal)

    monkeypatch.setattr(EpisodeMap, "route", noted)
    turn = looked(navigator, points, goal=np.array([east + 500.0, north]))
    assert turn == looked(Navigator(), points, goal=np.array([east + 20.0, north]))
    assert -1.2 < turn < -0.4
    assert ends[0] == pytest.approx([east + 20.0, north])


@pytest.mark.parametrize("far", [1e9, 1e30])
def test_a_place_where_no_vehicle_is_leads_nowhere(far: float) -> None:
    navigator, points = Navigator(), wall((2.0, 3.0), (2.0, -1.0))
    turn = looked(navigator, points)
    assert navigator.look(scanned(points, START * 0, STILL[0])[0], STILL[0], np.array([far, 0.0, 3.5]), GOAL) == 0.0
    assert looked(navigator, NOTHING) == turn


@pytest.mark.parametrize(("height", "stands"), [(0.1, True), (0.7, False)])
def test_the_sensor_is_where_it_is_told_to_be(height: float, stands: bool) -> None:
    """Points in the sensor's plane: at the flight level, or over it."""
    cloud = wall((2.0, 3.0), (2.0, -1.0)) * [1.0, 1.0, 0.0]
    navigator = Navigator(sensor_position=(0.0, 0.0, height))
    assert (navigator.look(cloud, STILL[0], START, GOAL) != 0.0) is stands


@pytest.mark.parametrize("broken", ["attitude", "place"])
def test_one_that_does_not_know_where_it_is_turns_nowhere_and_remembers(broken: str) -> None:
    navigator, points = Navigator(), wall((2.0, 3.0), (2.0, -1.0))
    turn = looked(navigator, points)
    told = {"attitude": STILL[0], "place": START} | {broken: np.full(3, np.nan)}
    assert navigator.look(NOTHING, told["attitude"], told["place"], GOAL) == 0.0
    assert looked(navigator, NOTHING) == pytest.approx(turn, abs=1e-9)


def test_nothing_is_imported_in_flight() -> None:
    """The first scan would otherwise be answered a third of a second late."""
    program = (
        "import sys, numpy as np; from uavrl_onboard.guards.map import Navigator;"
        "navigator = Navigator(); known = set(sys.modules);"
        "navigator.look(np.ones((9, 3)), np.zeros(3), np.array([0.0, 0.0, 3.5]), np.array([9.0, 0.0]));"
        "print(sorted(set(sys.modules) - known))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_one_that_has_got_nowhere_is_led_to_the_point_before_a_corner(monkeypatch: pytest.MonkeyPatch) -> None:
    """Elsewhere it is led to a point behind the corner."""
    told: list[bool] = []

    def noted(*given: Any, closely: bool) -> tuple[int, bool]:
        told.append(closely)
        return waypoint(*given, closely=closely)

    monkeypatch.setattr("uavrl_onboard.guards.map.navigator.waypoint", noted)
    navigator, points, scans = Navigator(), wall((2.0, 3.0), (2.0, -1.0)), round(CIRCLES / VEHICLE.period)
    for angle in np.arange(scans + 10) * 0.14:  # once around in 4.5 s
        looked(navigator, points, START + 0.4 * WITHIN * np.array([np.cos(angle), np.sin(angle), 0.0]))
    assert told == [False] * (scans - 1) + [True] * 11
    for far in np.arange(0.0, 2 * WITHIN, 0.2):
        looked(navigator, points, START - np.array([far, 0.0, 0.0]))
    assert told[-1] is False, "it has got away"
    navigator.reset()
    looked(navigator, points)
    assert told[-1] is False
