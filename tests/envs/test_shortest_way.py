"""The shortest ways on a place's map, and where they lead."""

from __future__ import annotations

import heapq
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from uavrl.envs import NavigationEnv
from uavrl.envs.level_map import LevelMap
from uavrl.envs.place import Place
from uavrl.envs.shortest_way import ShortestWays
from uavrl.envs.tasks import CELL
from uavrl.envs.world import World, WorldConfig

TRAPPED = WorldConfig(seeds=(200,), traps=3, obstacles=20)


def level_map(fits: np.ndarray, **kwargs: Any) -> LevelMap:
    place = SimpleNamespace(fits=fits, origin=np.zeros(2), corner=np.zeros(2), config=SimpleNamespace(uav_radius=0.3))
    return LevelMap(cast(Place, place), **kwargs)


def searched(fits: np.ndarray, last: tuple[int, int]) -> np.ndarray:
    """Lengths of the shortest ways in eight directions, by a search that is written out."""
    found, queue = np.full(fits.shape, np.inf), [(0.0, last)]
    while queue:
        length, (x, y) = heapq.heappop(queue)
        if length >= found[x, y]:
            continue
        found[x, y] = length
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                there = (x + i, y + j)
                inside = all(0 <= a < b for a, b in zip(there, fits.shape, strict=True))
                if inside and (i or j) and fits[there]:
                    heapq.heappush(queue, (length + CELL * float(np.hypot(i, j)), there))
    return found


def test_ways_are_as_long_as_those_of_a_search_that_is_written_out() -> None:
    fits = np.random.default_rng(0).random((12, 9)) < 0.7
    fits[4, 5] = True
    ways = level_map(fits).ways_to(np.array([4, 5]))
    wanted = np.where(fits, searched(fits, (4, 5)), np.inf)
    np.testing.assert_allclose(ways.lengths.reshape(fits.shape), wanted)
    assert np.isfinite(wanted).sum() > 40 and (~np.isfinite(wanted)).sum() > 10


def test_a_way_keeps_away_from_what_stands_where_that_is_not_much_longer() -> None:
    fits = np.ones((41, 21), bool)
    fits[20, :11] = False  # a wall, around whose end at y = 10 cells the way leads
    level = level_map(fits, comfort=1.0, crowded=2.0)
    ways, at = level.ways_to(np.array([40, 5])), int(level.number(np.array([0, 5])))
    passed = []
    while (at := int(ways.ahead[at])) >= 0:
        passed.append(np.unravel_index(at, fits.shape))
    beside = [y for x, y in passed if x == 20]
    assert min(beside) >= 12, "at least half a metre from the wall's end"


def walked(ways: ShortestWays, start: np.ndarray, goal: np.ndarray, level: LevelMap) -> tuple[float, float]:
    """How far from the goal steps of 0.1 m along ``way`` end, and the share of steps on cells in which a ball fits."""
    place, fitting = start.copy(), []
    for _ in range(600):
        if np.linalg.norm((place - goal)[:2]) < 0.5:
            break
        ahead = ways.directions(place[None], np.zeros(1))[0]
        place[:2] += 0.1 * ahead
        cell = level.cell(place)
        fitting.append(bool((level.fitting_cell(place) == cell).all()))
    return float(np.linalg.norm((place - goal)[:2])), float(np.mean(fitting))


def test_who_follows_the_way_gets_out_of_traps() -> None:
    world = World(TRAPPED)
    ways, level = ShortestWays(world, 1), LevelMap(world.places[0])
    for number in range(8):
        task = world.sample_task(np.random.default_rng(number))
        ways.begin(0, task.place, task.goal)
        left, fitting = walked(ways, task.start, task.goal, level)
        assert left < 0.5 and fitting > 0.9
        straight = (task.goal - task.start)[:2] * np.linspace(0, 1, 200)[:, None] + task.start[:2]
        assert not (level.fitting_cell(straight) == level.cell(straight)).all(), "the straight line meets a wall"


def test_a_vehicle_is_told_of_its_own_way_in_axes_of_its_yaw() -> None:
    env = NavigationEnv(2, world=TRAPPED, privileged=["way"], blind=True)
    first = env.reset()
    assert first["way"].norm(dim=-1).tolist() == pytest.approx([1.0, 1.0], abs=1e-5)
    ways = ShortestWays(env.world, 1)
    for one in range(2):
        ways.begin(0, 0, first["goal"][one].numpy())
        yaw = first["attitude"][one, 2:].numpy()
        there = ways.directions(first["position"][one][None].numpy().astype(float), yaw)
        np.testing.assert_allclose(first["way"][one], there[0], atol=1e-4)
    env.close()


def test_the_way_ends_at_the_goal() -> None:
    world = World(WorldConfig(seeds=(200,), obstacles=0))
    ways, task = ShortestWays(world, 1), world.sample_task(np.random.default_rng(0))
    ways.begin(0, 0, task.goal)
    near = task.goal + np.array([0.5, 0.0, 0.0])
    np.testing.assert_allclose(ways.directions(near[None], np.zeros(1)), [[-1.0, 0.0]], atol=1e-9)


def test_a_new_episode_has_a_new_way_and_the_others_keep_theirs() -> None:
    env = NavigationEnv(2, world=TRAPPED, privileged=["way"], blind=True)
    data = env.reset()
    before = data.clone()
    data["_reset"] = data["done"].clone()
    data["_reset"][0] = True
    again = env.reset(data)
    assert not again["goal"][0].allclose(before["goal"][0]) and again["goal"][1].allclose(before["goal"][1])
    assert again["way"][1].allclose(before["way"][1]) and not again["way"][0].allclose(before["way"][0])
    env.close()
