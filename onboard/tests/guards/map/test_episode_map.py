"""A map of an episode: the ways through it, the next waypoint, and where the goal is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uavrl_onboard.guards.map import EpisodeMap, GoalFinder
from uavrl_onboard.guards.map.lines import Obstacles
from uavrl_onboard.guards.map.route import SEEN_AROUND, find_route, route, waypoint
from uavrl_onboard.vehicle import VEHICLE

CELL = 0.25
GOAL = np.array([9.0, 0.0])
NONE = np.zeros((0, 2))


def cells(x: tuple[float, float], y: tuple[float, float]) -> np.ndarray:
    """The cells of a rectangle, its far sides left out: ``[K, 2]``."""
    sides = [np.arange(round(low / CELL), round(high / CELL)) for low, high in (x, y)]
    return np.stack(np.meshgrid(*sides), -1).reshape(-1, 2)


U = np.concatenate([cells((4, 4.25), (-3, 3)), cells((-1, 4.25), (2.75, 3)), cells((-1, 4.25), (-3, -2.5))])


def length(way: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def test_where_nothing_is_known_the_way_is_straight() -> None:
    way = route(np.zeros((0, 2), int), np.array([0.1, 0.1]), np.array([5.1, 0.1]), CELL)
    assert way is not None
    assert (
        way[0].tolist() == [0.1, 0.1] and way[-1].tolist() == [5.1, 0.1] and length(way) == pytest.approx(5.0, abs=0.01)
    )


def test_out_of_a_u_it_leads_back_and_around_the_thinner_arm() -> None:
    """All around is free: 3.7 m out of the U, 3 m aside, and 10 m ahead again."""
    way = route(U, np.array([2.5, 0.0]), GOAL, CELL)
    assert way is not None
    assert way[:, 0].min() < -1 - 0.35 and way[:, 1].max() > 3.35
    apart = np.linalg.norm(way[:, None] - (U + 0.5) * CELL, axis=-1)
    assert apart.min() > 0.6  # where there is room it keeps off
    assert 15 < length(way) < 20


def test_the_hull_goes_through_a_gap_that_it_fits_and_not_through_a_narrower_one() -> None:
    for gap, through in [(0.5, False), (1.5, True)]:
        wall = np.concatenate([cells((4, 4.25), (-6, -gap / 2)), cells((4, 4.25), (gap / 2, 6))])
        way = route(wall, np.zeros(2), GOAL, CELL)
        assert way is not None
        assert (np.abs(way[:, 1]).max() < 1.0) == through


def test_closed_in_there_is_no_way() -> None:
    ring = np.concatenate([U, cells((-1.25, -1), (-3, 3))])
    assert route(ring, np.array([2.5, 0.0]), GOAL, CELL) is None


def test_the_goal_is_where_its_directions_meet_and_before_that_far_ahead() -> None:
    finder = GoalFinder()
    assert finder.look(np.zeros(2), np.array([1.0, 0.0])) == pytest.approx([15.0, 0.0])
    for left in np.linspace(0, 4, 40):
        place = np.array([0.0, left])
        found = finder.look(place, (GOAL - place) / np.linalg.norm(GOAL - place))
    assert found == pytest.approx(GOAL, abs=0.2)


def test_what_is_farther_than_its_reach_is_forgotten() -> None:
    known = EpisodeMap(reach=10.0)
    known.look(np.array([[1.0, 0.1], [1.1, 0.2], [5.0, 0.0]]), np.zeros(2))
    assert known.occupied.tolist() == [[4, 0], [20, 0]]
    known.look(np.array([[13.0, 0.0]]), np.array([12.0, 0.0]))
    assert known.occupied.tolist() == [[20, 0], [52, 0]]


def test_a_start_and_a_goal_in_one_cell_are_the_way() -> None:
    ends = np.array([[0.3, 0.3], [0.4, 0.4]])
    np.testing.assert_array_equal(route(np.zeros((0, 2), int), *ends, 0.25), ends)


def test_a_cell_is_entered_once_whatever_its_signs() -> None:
    known = EpisodeMap()
    points = np.array([[-3.1, -0.1], [-3.1, 0.1], [3.1, -0.1], [0.1, 0.1]])
    for _ in range(2):
        known.look(points, np.zeros(2))
    assert known.occupied.tolist() == [[-13, -1], [-13, 0], [0, 0], [12, -1]]
    np.testing.assert_allclose(np.abs(known.middles()[:, 1]), CELL / 2)


def test_the_waypoint_is_the_goal_where_nothing_is_between() -> None:
    way = np.array([[0.0, 0.0], [3.0, 0.5], [6.0, 0.0]])
    assert waypoint(way, np.zeros(2), NONE, ahead=4.0) == (2, True)
    beside = np.array([[3.0, VEHICLE.radius + SEEN_AROUND + 0.01]])
    assert waypoint(way, np.zeros(2), beside, ahead=4.0) == (2, True)


def test_round_a_corner_the_waypoint_is_as_far_ahead_as_is_looked() -> None:
    way = np.column_stack([np.full(30, 0.0), np.arange(30) * 0.5])  # along y
    wall = np.column_stack([np.zeros(5), np.linspace(2.0, 3.0, 5)])  # across it, so that nothing is straight ahead
    point, straight = waypoint(way, np.zeros(2), wall, ahead=4.0)
    assert not straight and way[point, 1] == pytest.approx(4.0, abs=0.5)
    later, _ = waypoint(way, np.array([0.0, 5.0]), NONE, ahead=4.0)
    assert later == len(way) - 1


def test_it_forgets_what_is_far_also_where_nothing_is_seen() -> None:
    known = EpisodeMap(reach=10.0)
    known.look(np.array([[1.0, 0.1]]), np.zeros(2))
    known.look(NONE, np.array([12.0, 0.0]))
    assert not len(known.occupied)


@pytest.mark.parametrize("expected", [0.0, 0.7, 6.0])
def test_the_way_is_that_of_a_search_through_all_cells_whatever_detour_is_expected(expected: float) -> None:
    rng, detours = np.random.default_rng(0), []
    for walls in rng.integers(1, 12, 20):
        lines = [cells((x, x + 0.25), (y, y + 4.0)) for x, y in rng.uniform(-8.0, 8.0, (walls, 2))]
        begin, end = rng.uniform(-9.0, 9.0, (2, 2))
        way, detour = find_route(np.concatenate(lines), begin, end, CELL, detour=expected)
        whole, least = find_route(np.concatenate(lines), begin, end, CELL, detour=math.inf)
        np.testing.assert_array_equal(way, whole)
        assert detour == least
        detours.append(detour)
    assert min(detours) < 0.5 and max(detours) > 3.0


def test_the_waypoint_is_that_of_all_obstacles_and_all_points_of_the_way() -> None:
    rng, straight = np.random.default_rng(0), []
    for obstacles in (rng.uniform(-15.0, 15.0, (count, 2)) for count in rng.integers(0, 60, 60)):
        way = np.cumsum(rng.uniform(-0.1, 0.3, (70, 2)), axis=0)
        place = way[rng.integers(0, 40)] + 0.1
        first = int(((way - place) ** 2).sum(1).argmin())
        free = Obstacles(obstacles, place, VEHICLE.radius + SEEN_AROUND).free(np.tile(place, (70, 1)), way)[first:]
        last = int(free.nonzero()[0].max(initial=-1))
        sees_far = last >= 0 and (last == 69 - first or np.linalg.norm(way[first + last] - place) >= 4.0)
        found, is_straight = waypoint(way, place, obstacles, ahead=4.0)
        assert is_straight == sees_far and (found == first + last or not sees_far)
        straight.append(is_straight)
    assert 10 < sum(straight) < 50
