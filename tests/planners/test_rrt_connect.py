"""The planner by RRT-Connect: its ways, what it keeps of them, its reflex. What it shares: test_planners.py."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

from tests.planners.test_planners import flown, grid, scan, seen
from uavrl.errors import UavrlError
from uavrl.planners.ompl_search import filled, length, search
from uavrl.planners.rrt_connect import EVERY, RRTConnect, RRTConnectWeights
from uavrl_onboard.guards.map.lines import Obstacles, clearances

START, END = np.zeros(3), np.array([3.0, 0.0, 0.0])
BOX = np.array([[-4.0, -4.0, -0.5], [4.0, 4.0, 0.5]])


@pytest.fixture
def ompl() -> None:
    """Some machines have no wheel of it."""
    pytest.importorskip("ompl", reason="needs OMPL: pip install 'uavrl[planners]'")


def wall(left: tuple[float, float], kept: float = 0.5) -> Obstacles:
    return Obstacles(grid(1.5, left, (-1.0, 1.0)).double().numpy(), START, kept)


def room(half: float) -> torch.Tensor:
    """Four walls around the vehicle, as high as it sees."""
    y, z = torch.meshgrid(torch.linspace(-half, half, 17), torch.linspace(-1.5, 1.5, 11), indexing="ij")
    one = torch.stack([torch.full_like(y, half), y, z], -1).flatten(0, 1)
    turned = one[:, [1, 0, 2]]
    return torch.cat([one, one * torch.tensor([-1.0, 1.0, 1.0]), turned, turned * torch.tensor([1.0, -1.0, 1.0])])


def test_a_way_leads_around_a_wall_and_keeps_away_from_it(ompl: None) -> None:
    obstacles = wall((-4.0, 0.7))
    way = search(obstacles, START, END, BOX, 1.0, 150, seed=1)
    assert way is not None
    assert way[0] == pytest.approx(START) and way[-1] == pytest.approx(END)
    assert clearances(obstacles.points, way[:-1], way[1:]).min() >= 0.5
    assert length(way) < 7.0  # 3.9 m is the shortest


def test_the_same_seed_finds_the_same_way(ompl: None) -> None:
    first, other, again = (search(wall((-1.0, 1.0)), START, END, BOX, 1.0, 150, seed) for seed in (1, 2, 1))
    assert first is not None and again is not None and other is not None
    assert first.tolist() == again.tolist() and first.tolist() != other.tolist()


def test_where_there_is_no_way_none_is_found(ompl: None) -> None:
    assert search(wall((-5.0, 5.0)), START, END, BOX, 1.0, 30, seed=1) is None


def test_what_is_too_near_at_the_start_lets_it_out_but_not_nearer() -> None:
    obstacles = Obstacles(np.array([[0.3, 0.0, 0.0]]), START, 0.5)
    ends = np.array([[-1.0, 0.0, 0.0], [0.2, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert obstacles.free(np.zeros((3, 3)), ends).tolist() == [True, False, False]


def test_a_path_is_filled_from_corner_to_corner() -> None:
    path = filled(np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.0], [0.25, 1.0, 0.0]]))
    assert path[-1].tolist() == [0.25, 1.0, 0.0] and [0.25, 0.0, 0.0] in path.tolist()
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 0.1 + 1e-9


def test_it_plans_twice_a_second_and_keeps_its_path_meanwhile(ompl: None, monkeypatch: pytest.MonkeyPatch) -> None:
    plans: list[int] = []

    def counted(*told: object) -> np.ndarray:
        plans.append(int(told[-1]))  # type: ignore[call-overload]
        return np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])

    monkeypatch.setattr("uavrl.planners.rrt_connect.search", counted)
    rival = RRTConnect(costs=RRTConnectWeights(ahead=3.5))  # to a point behind the wall
    cloud = scan(grid(2.5, (-3.0, 0.7), (-1.0, 1.0)))
    actions = [rival(seen(cloud, fresh=step == 0))["action"][0] for step in range(EVERY + 1)]
    assert EVERY == 5 and plans == [1, 2]
    assert all(action[1] > 1.0 and abs(action[0]) < 0.1 for action in actions)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_wall_with_a_gap_is_passed_through_the_gap(ompl: None, side: float) -> None:
    """The wall ends 0.6 m to the gap's side of the straight way."""
    across = grid(2.5, (-2.5, 0.65), (-1.5, 1.5)) * torch.tensor([1.0, side, 1.0])
    path = flown(RRTConnect(), across, 60)
    assert path[-1, 0] > 3.0
    passing = path[np.abs(path[:, 0] - 2.5) < 0.35]
    assert (side * passing[:, 1] > 0.6 + 0.35).all()


def test_closed_in_the_reflex_flies_along_the_walls_at_its_distance(ompl: None) -> None:
    """No way leads out of a room: it goes on to fly in it, and touches nothing."""
    rival = RRTConnect(tries=20)
    path = flown(rival, room(1.6), 80)
    assert np.abs(path[:, :2]).max() < 1.6 - 0.35
    assert length(path) > 2.0


def test_the_reflex_goes_to_and_from_an_obstacle_by_its_distance(ompl: None) -> None:
    costs = RRTConnectWeights(reflex=0.8, distance=0.4, gain=1.0)
    rival, goal = RRTConnect(costs=costs), np.array([0.6, 0.8, 0.0])
    for x, back in [(0.35 + 0.1, 0.3), (0.35 + 0.4, 0.0), (0.35 + 0.9, -0.5), (0.35 + 2.9, -0.8)]:
        velocity, side = rival._reflex(np.array([[x, 0.0, 0.0]]), START, goal, 0.0)
        assert velocity[0] == pytest.approx(-back) and np.linalg.norm(velocity) == pytest.approx(0.8)
        assert velocity[1] >= 0 and side == -1.0
    assert rival._reflex(np.array([[0.75, 0.0, 0.0]]), START, goal, 1.0)[0][1] == pytest.approx(
        -0.8
    )  # the side is held


def test_without_ompl_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(
        UavrlError, match=r"policy=rrt_connect and policy=rrt_map need OMPL: pip install 'uavrl\[planners\]'\.$"
    ):
        RRTConnect()
