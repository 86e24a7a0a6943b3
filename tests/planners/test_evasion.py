"""Planners that are told what moves keep out of its way, and off what stands."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import pytest
import torch
from tensordict import TensorDict

from uavrl.config.build import find_class
from uavrl.envs import Airframe
from uavrl.evaluation.policies import BASELINES, named_policy
from uavrl.planners.point_memory import PERIOD, Planner
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl_onboard.geometry import hull_distances
from uavrl_onboard.guards.evade import evaded
from uavrl_onboard.perception.motion.threats import HIGH, STEPS, WIDE
from uavrl_onboard.vehicle import VEHICLE

PLANNERS = ("vfh_star", "mppi", "potential_field", *["rrt_connect", "rrt_map"] * bool(find_spec("ompl")))
NOTHING = torch.full((1, 16, 3), torch.nan)
NONE = torch.zeros(0, 3)


def made(name: str, motion: float | None) -> Planner:
    return find_class(BASELINES[name], Planner)(motion=motion)


def flight(planner: Callable[[TensorDict], TensorDict], begin: list[float], speed: list[float]) -> float:
    """How near a body comes that flies straight on, while the planner flies ahead; 1 keeps the margin, 0.66 touches."""
    place, velocity, nearest = torch.zeros(3), torch.tensor([2.0, 0.0, 0.0]), float("inf")
    for step in range(40):
        apart = torch.tensor(begin) + PERIOD * step * torch.tensor(speed) - place
        nearest = min(nearest, float(torch.maximum(apart[:2].norm() / WIDE, apart[2].abs() / HIGH)))
        from_lidar = apart - torch.tensor([0.0, 0.0, VEHICLE.lidar_above])
        told = torch.cat([from_lidar, torch.tensor([*speed, 1.0]), torch.zeros(14)])
        state = {
            "point_cloud": NOTHING,
            "is_init": torch.tensor([[step == 0]]),
            "altitude": 3.5 + place[None, 2:],
            "heading_deg": torch.zeros(1, 1),
            "velocity": velocity[None],
            "attitude": torch.zeros(1, 3),
            "moving_objects": told[None],
        }
        velocity = velocity + 0.22 * (planner(TensorDict(state, [1]))["action"][0, :3] - velocity)
        place = place + PERIOD * velocity
    return nearest


@pytest.mark.parametrize("name", PLANNERS)
@pytest.mark.parametrize(
    ("begin", "speed"),
    [([8.0, 0.2, 0.0], [-3.0, 0.0, 0.0]), ([4.0, 6.0, 0.0], [0.0, -3.0, 0.0]), ([4.0, -6.0, 0.2], [0.0, 3.0, 0.0])],
    ids=["ahead", "left", "right"],
)
def test_a_planner_that_is_told_what_moves_keeps_out_of_its_way(
    name: str, begin: list[float], speed: list[float]
) -> None:
    assert flight(made(name, None), begin, speed) < 0.6
    assert flight(made(name, 12.0), begin, speed) > 0.95


def test_what_moves_is_told_from_the_lidar_and_reckoned_from_the_hull() -> None:
    """The LiDAR sits 0.5 m over the hull's middle, which is 0.3 m ahead of it where the vehicle pitches by 0.6435."""
    planner = find_class(BASELINES["mppi"], Planner)(motion=12.0, airframe=Airframe(lidar_position=(0.0, 0.0, 0.5)))
    told = torch.tensor([5.0, 0.0, -0.5, -3.0, 0.0, 0.0, 1.0, *[0.0] * 14]).expand(2, -1)
    tilts = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.6435, 2.0]])
    state = TensorDict({"moving_objects": told, "attitude": tilts, "is_init": torch.zeros(2, 1, dtype=torch.bool)}, [2])
    ways, known = planner._moving(state)
    assert known.tolist() == [[True, False, False]] * 2
    assert ways[:, 0, 0].flatten().tolist() == pytest.approx([4.7, 0.0, 0.0, 5.0, 0.0, -0.1], abs=1e-4)


@pytest.mark.parametrize("name", PLANNERS)
def test_perception_says_whether_a_planner_is_told(name: str) -> None:
    told = {"flight_level": 3.5, "radius": 4.0}
    assert "moving_objects" in named_policy(name, {**told, "motion": 12.0}, ()).in_keys
    assert "moving_objects" not in named_policy(name, {**told, "motion": None}, ()).in_keys


def bodies(*begins: list[float], speed: tuple[float, float, float]) -> tuple[torch.Tensor, torch.Tensor]:
    """The ways of bodies that fly straight on, one for each vehicle."""
    times = PERIOD * torch.arange(1, STEPS + 1)
    ways = torch.tensor(begins)[:, None, None] + times[:, None] * torch.tensor(speed)
    return ways, torch.ones(len(begins), 1, dtype=torch.bool)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_gives_way_to_the_side_on_which_nothing_stands(side: float) -> None:
    """A body comes ahead, a little to the free side; on the other one there is a wall, 0.9 m away."""
    y, z = torch.arange(-1.0, 4.0, 0.1), torch.arange(-1.5, 1.6, 0.1)
    wall = torch.stack([a.flatten() for a in torch.meshgrid(y, z, indexing="ij")], -1)
    wall = torch.stack([wall[:, 0], torch.full((len(wall),), -0.9 * side), wall[:, 1]], -1)
    ahead = torch.tensor([[2.0, 0.0, 0.0]])
    ways, known = bodies([4.0, 0.3 * side, 0.0], speed=(-3.0, 0.0, 0.0))
    free = call_numpy(evaded, ahead, ahead, ways, known, [NONE], torch.zeros(1, 1))
    beside = call_numpy(evaded, ahead, ahead, ways, known, [wall], torch.zeros(1, 1))
    assert side * free[0, 1] < 0, "away from the body, were it not for the wall"
    assert side * beside[0, 1] >= 0
    assert call_numpy(hull_distances, wall, 1.0 * beside[:, None], 0.15).min() > 0.15, "after a second"


def test_only_whom_a_body_threatens_gives_way() -> None:
    ahead = torch.tensor([[2.0, 0.0, 0.0]] * 3)
    ways, known = bodies([6.0, 0.0, 0.0], [6.0, 5.0, 0.0], [6.0, 0.0, 0.0], speed=(-3.0, 0.0, 0.0))
    known[2] = False
    found = call_numpy(evaded, ahead, ahead, ways, known, [NONE] * 3, torch.zeros(3, 1))
    assert (found[0] - ahead[0]).norm() > 0.5
    assert torch.equal(found[1:], ahead[1:])


def test_it_does_not_climb_out_of_where_it_may_fly() -> None:
    """Over the flight level by what is allowed, it does not rise further; low over the ground it does not sink."""
    ahead = torch.tensor([[2.0, 0.0, 0.0]] * 2)
    ways, known = bodies([4.0, 0.0, 0.0], [4.0, 0.0, 0.0], speed=(-3.0, 0.0, 0.0))
    high, low = call_numpy(evaded, ahead, ahead, ways, known, [NONE] * 2, torch.tensor([[0.7], [-2.3]]))
    assert high[2] <= 0 and low[2] >= 0
    assert (high - ahead[0]).norm() > 0.5 and (low - ahead[1]).norm() > 0.5
