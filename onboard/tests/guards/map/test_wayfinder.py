"""Vehicles that are led by what they have seen: straight on, around a wall, out of a dead end."""

from __future__ import annotations

import numpy as np
import pytest

from uavrl_onboard.geometry import body_to_world
from uavrl_onboard.guards.map import Wayfinder
from uavrl_onboard.guards.map.navigator import EVERY
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.vehicle import VEHICLE

ALTITUDE = 3.5
STILL = np.zeros((1, 3))


def wall(start: tuple[float, float], end: tuple[float, float]) -> np.ndarray:
    """Points of an upright wall around the flight level, ``[P, 3]`` m from the episode's start."""
    share, up = np.linspace(0, 1, 60), np.linspace(-0.3, 0.3, 5)
    level = np.array(start) + share[:, None] * (np.array(end) - start)
    return np.concatenate([np.column_stack([level, np.full(len(level), height)]) for height in up])


def scanned(points: np.ndarray, place: np.ndarray, attitude: np.ndarray) -> np.ndarray:
    """A scan ``[1, P, 3]`` of points, by the sensor of a vehicle at ``place [3]`` with ``attitude [3]``."""
    rotation = body_to_world(attitude[None])[0]
    return ((points - place - VEHICLE.lidar_above * rotation[:, 2]) @ rotation)[None]


def look(finder: Wayfinder, clouds: np.ndarray, *state: np.ndarray, which: np.ndarray | None = None) -> np.ndarray:
    return finder.lead(Situation(clouds, *state, which=which))


def looked(finder: Wayfinder, points: np.ndarray, heading: float = 0.0, attitude: np.ndarray = STILL[0]) -> float:
    cloud = scanned(points, np.zeros(3), attitude)
    return float(look(finder, cloud, STILL, attitude[None], np.array([ALTITUDE]), np.array([heading]))[0])


def test_where_nothing_is_known_it_leads_straight_on() -> None:
    finder = Wayfinder(1)
    for nothing in (np.nan, np.inf, 0.0):
        cloud = np.full((1, 40, 3), nothing)
        for _ in range(EVERY + 1):
            assert look(finder, cloud, STILL, STILL, np.array([ALTITUDE]), np.array([2.0]))[0] == 0.0


@pytest.mark.parametrize(("left", "right", "sign"), [(3.0, -1.0, -1), (1.0, -3.0, 1)])
def test_around_a_wall_it_leads_past_the_nearer_end(left: float, right: float, sign: int) -> None:
    turn = looked(Wayfinder(1), wall((2.0, left), (2.0, right)))
    assert 0.3 < sign * turn < 1.3


@pytest.mark.parametrize("attitude", [(0.2, 0.0, 0.0), (0.0, -0.2, 0.0), (0.1, 0.1, 2.0), (0.0, 0.0, -2.5)])
def test_neither_tilt_nor_yaw_changes_the_way(attitude: tuple[float, float, float]) -> None:
    points = wall((2.0, 3.0), (2.0, -1.0))
    level = looked(Wayfinder(1), points)
    tilted = looked(Wayfinder(1), points, heading=-attitude[2], attitude=np.array(attitude))
    assert tilted == pytest.approx(level, abs=0.1)


@pytest.mark.parametrize(("height", "stands"), [(0.1, True), (0.7, False)])
def test_the_sensor_is_where_it_is_told_to_be(height: float, stands: bool) -> None:
    """Points in the sensor's plane: at the flight level, or over it."""
    cloud = (wall((2.0, 3.0), (2.0, -1.0)) * [1.0, 1.0, 0.0])[None]
    finder = Wayfinder(1, sensor_position=(0.0, 0.0, height))
    turn = float(look(finder, cloud, STILL, STILL, np.array([ALTITUDE]), np.zeros(1))[0])
    assert (turn != 0.0) is stands


def test_what_is_over_or_under_the_flight_level_is_no_obstacle() -> None:
    points = wall((2.0, 3.0), (2.0, -1.0))
    for height in (-1.0, 1.0):
        assert looked(Wayfinder(1), points + np.array([0.0, 0.0, height])) == 0.0


def test_what_lies_beyond_its_sight_is_no_obstacle() -> None:
    points = wall((6.0, 3.0), (6.0, -1.0))
    assert looked(Wayfinder(1, sight=5.0), points) == 0.0
    assert looked(Wayfinder(1, sight=12.0), points) != 0.0


def test_each_vehicle_has_a_map_of_its_own_and_a_reset_forgets_no_other() -> None:
    ahead, nothing = scanned(wall((2.0, 3.0), (2.0, -1.0)), np.zeros(3), STILL[0])[0], np.full((300, 3), np.nan)
    told = (np.zeros((2, 3)), np.zeros((2, 3)), np.full(2, ALTITUDE), np.zeros(2))
    finder = Wayfinder(2)
    first = look(finder, np.stack([ahead, nothing]), *told)
    assert first[0] < 0 and first[1] == 0
    remembered = look(finder, np.stack([nothing, nothing]), *told)
    assert remembered[0] == pytest.approx(first[0], abs=0.05)
    finder.reset(np.array([False, True]))
    assert look(finder, np.stack([nothing, nothing]), *told)[0] == pytest.approx(first[0], abs=0.05)
    finder.reset(np.array([True, False]))
    assert look(finder, np.stack([nothing, nothing]), *told, which=np.array([True, False])).tolist() == [0.0, 0.0]


def test_its_place_is_its_velocity_integrated() -> None:
    """Seen 5 m ahead once, and then no more: after 1.5 s at 2 m/s the wall is 2 m ahead."""
    finder, points = Wayfinder(1), wall((5.0, 3.0), (5.0, -1.0))
    velocity = np.array([[2.0, 0.0, 0.0]])
    for step in range(16):
        cloud = scanned(points, np.zeros(3), STILL[0]) if step == 0 else np.full((1, 300, 3), np.nan)
        turn = look(finder, cloud, velocity, STILL, np.array([ALTITUDE]), np.zeros(1))[0]
    at_once = looked(Wayfinder(1), wall((2.0, 3.0), (2.0, -1.0)))
    assert turn == pytest.approx(at_once, abs=0.15)


def test_led_by_it_a_vehicle_that_avoids_nothing_gets_out_of_a_dead_end() -> None:
    """A U of 5 m width, closed 5 m ahead: without a map it would fly against the closed side."""
    points = np.concatenate([wall((5, -2.5), (5, 2.5)), wall((0, 2.5), (5, 2.5)), wall((0, -2.5), (5, -2.5))])
    goal, place, velocity, yaw = np.array([11.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.zeros(3), 0.0
    finder, path = Wayfinder(1, sight=4.0), []
    for _ in range(300):
        attitude = np.array([0.0, 0.0, yaw])
        apart = np.linalg.norm(points - place, axis=1)
        near = np.where((apart < 4.0)[:, None], points, np.nan)
        bearing = np.arctan2(*(goal - place[:2])[::-1])
        told = (velocity[None], attitude[None], np.array([ALTITUDE]), np.array([bearing - yaw]))
        turn = look(finder, scanned(near, place, attitude), *told)[0]
        course = bearing + turn
        velocity = velocity + 0.5 * (1.5 * np.array([np.cos(course), np.sin(course), 0.0]) - velocity)
        yaw += 0.3 * ((course - yaw + np.pi) % (2 * np.pi) - np.pi)
        place = place + 0.1 * velocity
        path.append(place)
        if np.linalg.norm(goal - place[:2]) < 1:
            break
    flown = np.array(path)
    assert np.linalg.norm(goal - place[:2]) < 1
    assert flown[:, 0].min() < 0.0 and np.abs(flown[:, 1]).max() > 2.5  # out of its mouth, around an arm
    assert np.linalg.norm(flown[:, None] - points, axis=-1).min() > 0.1  # to keep off walls is the policy's part


@pytest.mark.parametrize("broken", range(4))
def test_one_that_does_not_know_itself_turns_nowhere_and_goes_on_afterwards(broken: int) -> None:
    """Velocity, attitude, altitude or heading are no numbers for a while, also at the beginning."""
    cloud = scanned(wall((2.0, 3.0), (2.0, -1.0)), np.zeros(3), STILL[0])
    finder, whole = Wayfinder(1), [STILL, STILL, np.array([ALTITUDE]), np.zeros(1)]
    torn = [value * np.nan if place == broken else value for place, value in enumerate(whole)]
    for told in (torn, whole, torn):
        turn = look(finder, cloud, *told)[0]
        assert (turn == 0) == (told is torn)
    for _ in range(EVERY + 1):
        assert look(finder, cloud, *whole)[0] < 0
    finder.reset(np.array([True]))
    assert look(finder, cloud, *whole)[0] < 0
