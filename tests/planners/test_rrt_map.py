"""The planner with a map of its episode: what enters the map, and out of a dead end."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
import torch

from tests.planners.test_planners import grid, scan, seen
from uavrl.planners.rrt_connect import EVERY, RRTConnect
from uavrl.planners.rrt_map import RRTMap
from uavrl_onboard.perception.cells import LASERS

CELL = 0.25
needs_ompl = pytest.mark.skipif(not find_spec("ompl"), reason="needs OMPL: pip install 'uavrl[planners]'")


def u_of_points() -> torch.Tensor:
    """A U that opens towards -x: 5 m wide, its closed side 5 m ahead, its arms 5 m long."""
    back, arm = grid(5.0, (-2.5, 2.5), (-1.5, 1.5)), grid(0.0, (0.0, 5.0), (-1.5, 1.5))
    arms = [torch.stack([arm[:, 1], torch.full_like(arm[:, 0], side), arm[:, 2]], -1) for side in (-2.5, 2.5)]
    return torch.cat([back, *arms])[::2]


def tracked(rival: RRTConnect, obstacles: torch.Tensor, goal: torch.Tensor, steps: int) -> np.ndarray:
    """Where a vehicle comes to from (1, 0), whose velocity follows its commands with a lag, until it is at the goal."""
    place, velocity, path = torch.tensor([1.0, 0.0, 0.0]), torch.zeros(3), []
    for step in range(steps):
        apart = obstacles - place
        near = apart[apart.norm(dim=-1) < 4.0]
        near = near[:: len(near) // (LASERS * 64) + 1]
        heading = torch.rad2deg(torch.atan2(goal[1] - place[1], goal[0] - place[0])).reshape(1, 1)
        told = {"velocity": velocity[None], "altitude": 3.5 + place[None, 2:], "heading_deg": heading}
        action = rival(seen(scan(near), fresh=step == 0, **told))["action"][0, :3]
        velocity = velocity + 0.22 * (action - velocity)
        place = place + 0.1 * velocity
        path.append(place.numpy())
        if (goal - place[:2]).norm() < 1:
            break
    return np.stack(path)


@needs_ompl
def test_it_flies_out_of_a_u_in_which_the_planner_without_a_map_stays() -> None:
    goal, points = torch.tensor([11.0, 0.0]), u_of_points()
    inside = tracked(RRTConnect(seconds=3.0, tries=30), points, goal, 60)
    assert inside[30:, 0].min() > 1.0 and inside[:, 0].max() < 5.0
    path = tracked(RRTMap(seconds=3.0, tries=30), points, goal, 200)
    assert np.linalg.norm(path[-1, :2] - goal.numpy()) < 1
    assert path[:, 0].min() < 0.0 and np.abs(path[:, 1]).max() > 2.5 + 0.35  # out of its mouth, around an arm
    apart = np.linalg.norm(path[:, None, :2] - points[None, :, :2].numpy(), axis=-1)
    assert apart.min() > 0.35


@needs_ompl
def test_a_reset_forgets_its_own_map_and_no_other() -> None:
    rival, wall, nothing = RRTMap(), scan(grid(2.0, (-1.0, 1.0))), scan(torch.zeros(0, 3))
    for step in range(EVERY + 1):
        rival(seen(wall, wall, fresh=step == 0))
    one, two = (len(known.occupied) for known in rival._maps)
    assert one == two > 5
    state = seen(nothing, nothing)
    state["is_init"][0] = True
    rival(state)
    assert [len(known.occupied) for known in rival._maps] == [0, two]


@needs_ompl
def test_only_what_is_at_the_flight_level_is_in_the_way() -> None:
    """The vehicle is 1 m below it: so is a sill, and a beam is there."""
    sill, beam = grid(2.0, (-1.0, 0.0), (-0.1, 0.1)), grid(3.0, (0.0, 1.0), (0.9, 1.1))
    rival = RRTMap()
    rival(seen(scan(torch.cat([sill, beam])), fresh=True, altitude=torch.tensor([[2.5]])))
    places = (rival._maps[0].occupied + 0.5) * CELL
    assert len(places) == 4 and np.abs(places[:, 0] - 3.0).max() < 0.2 and (places[:, 1] > 0).all()


@needs_ompl
def test_with_nothing_in_sight_it_acts_like_the_planner_without_a_map() -> None:
    state = seen(scan(torch.zeros(0, 3)), fresh=True, heading_deg=torch.tensor([[30.0]]))
    led, alone = (rival(state.clone())["action"] for rival in (RRTMap(), RRTConnect()))
    assert torch.allclose(led, alone, atol=1e-4)


@needs_ompl
def test_the_map_does_not_turn_with_the_vehicle() -> None:
    rival = RRTMap()
    rival(seen(scan(grid(2.0, (-0.9, 0.9))), fresh=True, attitude=torch.tensor([[0.0, 0.0, np.pi / 2]])))
    places = (rival._maps[0].occupied + 0.5) * CELL
    assert np.abs(places[:, 1] - 2.0).max() < 0.2 and len(places) > 4
    goal = rival._goals[0].look(np.zeros(2), np.array([0.0, 1.0]))
    assert goal == pytest.approx([0.0, 15.0], abs=1e-3)
