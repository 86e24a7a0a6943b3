"""The rule that learns nothing: it turns from what is near, by what it sees, and says where it has no costs."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import InitTracker, TransformedEnv

from uavrl.config.build import find_class
from uavrl.envs import NavigationEnv
from uavrl.envs.privileged import QUANTITIES
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import BASELINES, named_policy
from uavrl.planners.point_memory import Planner
from uavrl.policies.baselines import COSTS, VectorFieldHistogram, VFHWeights, keep_headway
from uavrl.policy_protocol import AdaptedPolicy, PolicyModule
from uavrl.transforms import NavigationState
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl.transforms.reduction import Statistic
from uavrl.transforms.state import REDUCTIONS
from uavrl_onboard.perception.reductions import Reduction
from uavrl_onboard.vehicle import DECELERATION, REACTION


class Told:
    """A policy from elsewhere, with a radius of its own meaning."""

    def __init__(self, flight_level: float = 1.0, radius: float = 0.1) -> None:
        self.flight_level, self.radius = flight_level, radius

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict


def flown(rule: VectorFieldHistogram, faces: torch.Tensor) -> list[float]:
    state = {"faces": faces[None], "heading_deg": torch.zeros(1, 1), "altitude": torch.full((1, 1), 3.5)}
    return rule(TensorDict(state, [1]))["action"][0].tolist()


@pytest.mark.parametrize("reduction", REDUCTIONS)
def test_it_flies_ahead_where_nothing_is_and_turns_from_what_is_there(reduction: Reduction) -> None:
    rule, directions = VectorFieldHistogram(reduction=reduction), REDUCTIONS[reduction].directions()
    assert flown(rule, torch.zeros(len(directions))) == pytest.approx([2.0, 0.0, 0.0, 0.0], abs=1e-5)
    ahead_and_right = (directions[:, 0] > 0.3) & (directions[:, 1] < 0.2)
    forward, left, _, turn = flown(rule, 3.6 * ahead_and_right.float())
    assert left > 0.1 and turn > 0.2 and forward < 2.0


@pytest.mark.parametrize(
    ("heading", "turn"), [(121.0, 1.0), (175.0, 1.0), (179.9, 1.0), (180.1, -1.0), (185.0, -1.0), (239.0, -1.0)]
)
@pytest.mark.parametrize("blocked", [-1.0, 0.0, 1.0])
def test_with_the_goal_behind_it_turns_to_the_goals_side_wherever_it_flies(
    heading: float, turn: float, blocked: float
) -> None:
    """An obstacle behind, to one side or to the other, does not change the side: a vehicle that turns turns on."""
    directions = REDUCTIONS["range_image"].directions()
    cells = 3.6 * ((directions[:, 0] < -0.3) & (blocked * directions[:, 1] > 0.2)).float()
    state = {"faces": cells[None], "heading_deg": torch.tensor([[heading]]), "altitude": torch.full((1, 1), 3.5)}
    rule = VectorFieldHistogram(reduction="range_image")
    assert rule(TensorDict(state, [1]))["action"][0, 3].item() == turn


@pytest.mark.parametrize(("heading", "turn"), [(119.0, -1.0), (241.0, 1.0)])
def test_elsewhere_it_turns_to_where_it_flies(heading: float, turn: float) -> None:
    """An obstacle on the goal's side leaves the other side alone."""
    directions = REDUCTIONS["range_image"].directions()
    cells = 4.0 * ((directions[:, 1] * -turn) > 0.1).float()
    state = {"faces": cells[None], "heading_deg": torch.tensor([[heading]]), "altitude": torch.full((1, 1), 3.5)}
    rule = VectorFieldHistogram(reduction="range_image", costs=VFHWeights(9.0, 1.0, 0.3, 0.2, 6.0, 2.0, 0.9))
    assert rule(TensorDict(state, [1]))["action"][0, 3].item() == turn


@pytest.mark.parametrize("seen", COSTS)
def test_it_turns_slowly_and_its_direction_changes_gradually(seen: tuple[Reduction, Statistic]) -> None:
    """The goal wanders by a quarter of a degree a step in front of an obstacle: no step of the grid of 15 is seen."""
    directions = REDUCTIONS[seen[0]].directions()
    rule = VectorFieldHistogram(reduction=seen[0], statistic=seen[1])
    headings = torch.arange(-80.0, 80.0, 0.25)[:, None]
    cells = (2.0 * (directions[:, 0] > 0.9)).expand(len(headings), -1)
    state = TensorDict({"faces": cells, "heading_deg": headings, "altitude": torch.full_like(headings, 3.5)}, [640])
    action = rule(state)["action"]
    assert action[:, 3].abs().max() <= 1.0
    assert action[:, 1].max() > 1.0 and action[:, 1].min() < -1.0  # it does go to either side
    steps = action.diff(dim=0).abs()
    assert (steps.amax(-1) > 0.01).sum() <= 1  # where it chooses the other side of the obstacle


@pytest.mark.parametrize("seen", COSTS)
@pytest.mark.parametrize("altitude", [1.0, 2.5, 3.5, 4.5, 6.0])
def test_it_returns_to_the_flight_level_where_nothing_is(seen: tuple[Reduction, Statistic], altitude: float) -> None:
    """It flies ahead to the goal, within 1 m of the level after 5 s; the way there is 1 m/s steep."""
    rule, at = VectorFieldHistogram(reduction=seen[0], statistic=seen[1]), torch.tensor([[altitude]])
    cells = torch.zeros(1, len(REDUCTIONS[seen[0]].directions()))
    for _ in range(50):
        state = TensorDict({"faces": cells, "heading_deg": torch.zeros(1, 1), "altitude": at}, [1])
        (forward, left, up, turn) = rule(state)["action"][0].tolist()
        assert forward > 1.7 and (left, turn) == pytest.approx((0.0, 0.0), abs=1e-5)
        at = at + 0.1 * up
    assert abs(at.item() - 3.5) < 1.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_passes_an_obstacle_on_the_side_that_it_has_chosen(side: float) -> None:
    """The goal lies a degree to the other side; after a reset, and where it is not told, that decides."""
    ahead = 2.5 * (REDUCTIONS["range_image"].directions()[:, 0] > 0.9).float()[None]
    state = {"faces": ahead, "heading_deg": torch.full((1, 1), -side), "altitude": torch.full((1, 1), 3.5)}

    def left(last: list[float], **told: bool) -> float:
        seen = TensorDict({**state, "observation": torch.tensor([[9.0, *last, 0.0]])}, [1])
        return VectorFieldHistogram(reduction="range_image", **told)(seen)["action"][0, 1].item()  # type: ignore[arg-type]

    assert left([0.5, 0.5 * side, 0.0], last_action=True) * side > 0.5
    assert left([0.0, 0.0, 0.0], last_action=True) * side < -0.5
    assert left([0.5, 0.5 * side, 0.0]) * side < -0.5


def test_with_headway_a_gap_bounds_the_speed_towards_it_and_free_air_bounds_nothing() -> None:
    directions = REDUCTIONS["range_image"].directions()
    ahead = directions[:, 0] > 0.9
    costs = dataclasses.replace(COSTS["range_image", "proximity"], obstacle=0.0, caution=0.0, headway=0.7)

    def forward(distance: float, last: float = 0.0, hull: float = 0.35, **told: bool) -> float:
        cells = ((4.0 - distance) * ahead.float())[None]
        state = {"faces": cells, "heading_deg": torch.zeros(1, 1), "altitude": torch.full((1, 1), 3.5)}
        state |= {"observation": torch.tensor([[last, 0.0, 0.0, 0.0]])}
        airframe = {"collision_radius": hull}
        rule = VectorFieldHistogram(reduction="range_image", costs=costs, airframe=airframe, **told)  # type: ignore[arg-type]
        action = rule(TensorDict(state, [1]))["action"][0, :3]
        gap = distance - hull - 0.12 - 0.3 * 2.0 * last * directions[ahead, 0]
        assert bool((directions[ahead] @ action <= gap.clamp_min(0) / 0.7 + 1e-3).all()) or distance >= 2.5
        return float(action[0])

    assert forward(4.0) == forward(2.6) == pytest.approx(2.0)
    assert forward(1.2) == pytest.approx(0.73 / 0.7, abs=0.05)
    assert forward(1.2, hull=0.65) == pytest.approx(0.43 / 0.7, abs=0.05)
    assert forward(1.2, last=1.0, last_action=True) == pytest.approx(0.13 / 0.7, abs=0.1)
    assert forward(0.4) == pytest.approx(0.0, abs=1e-5)


def test_headway_at_speed_begins_far_enough_ahead_and_gently() -> None:
    """A wall comes nearer to a vehicle at 3.4 m/s: the forward command falls, and never by leaps."""
    directions = REDUCTIONS["range_image"].directions()
    ahead = (directions[:, 0] > 0.9).float()
    costs = dataclasses.replace(COSTS["range_image", "proximity"], obstacle=0.0, caution=0.0, headway=0.7)
    rule = VectorFieldHistogram(radius=6.0, reduction="range_image", costs=costs, last_action=True, max_speed=6.0)
    commands = []
    for step in range(48):
        state = {"faces": ((0.2 + 0.1 * step) * ahead)[None], "heading_deg": torch.zeros(1, 1)}
        state |= {"altitude": torch.full((1, 1), 3.5), "observation": torch.tensor([[3.4 / 6, 0.0, 0.0, 0.0]])}
        commands.append(float(rule(TensorDict(state, [1]))["action"][0, 0]))
    assert commands[0] > 3.0 and commands[-1] < 0.5
    assert max(abs(after - before) for before, after in pairwise(commands)) < 0.5


def test_headway_needs_distances() -> None:
    costs = dataclasses.replace(COSTS["truncated_icosahedron", "face"], headway=0.7)
    with pytest.raises(UavrlError, match="headway reads distances from cells of statistic=proximity, and these are of"):
        VectorFieldHistogram(costs=costs)


def test_many_bounds_at_once_are_hardly_exceeded() -> None:
    generator = torch.Generator().manual_seed(0)
    towards = REDUCTIONS["range_image"].directions()
    velocity = 4.0 * torch.rand(200, 3, generator=generator) - 2.0
    speed = 3.0 * torch.rand(200, len(towards), generator=generator)
    kept = call_numpy(keep_headway, velocity, towards, speed)
    assert ((velocity @ towards.T - speed).amax(-1) > 0.5).float().mean() > 0.9
    assert ((kept @ towards.T - speed).amax(-1) < 0.15).float().mean() > 0.95
    free = torch.full_like(speed, torch.inf)
    assert torch.equal(call_numpy(keep_headway, velocity, towards, free), velocity)


@pytest.mark.parametrize("seen", COSTS)
def test_policy_vfh_has_the_costs_of_what_it_sees(seen: tuple[Reduction, str]) -> None:
    reduction, statistic = seen
    told = {"flight_level": 3.0, "radius": 5.0, "reduction": reduction, "statistic": statistic, "frames": 3}
    rule = named_policy("vfh", told, ())
    assert isinstance(rule, VectorFieldHistogram)
    assert (rule.costs, rule.vehicle.flight_level, rule.radius) == (COSTS[seen], 3.0, 5.0)  # type: ignore[index]


def test_without_costs_it_says_what_to_choose() -> None:
    told = {"flight_level": 3.5, "radius": 4.0, "reduction": "range_image", "statistic": "range"}
    with pytest.raises(UavrlError, match=r"none for range_image with range: set perception\.reduction"):
        named_policy("vfh", told, ())


def test_a_class_from_elsewhere_is_told_the_flight_level_alone() -> None:
    policy = named_policy("tests.policies.test_baselines.Told", {"flight_level": 3.0, "radius": 4.0}, ("tests",))
    assert isinstance(policy, AdaptedPolicy)
    told: Any = policy.act
    assert (told.flight_level, told.radius) == (3.0, 0.1)


@pytest.mark.parametrize("name", BASELINES)
def test_torchrl_rolls_a_rule_out(name: str) -> None:
    rule = find_class(BASELINES[name], PolicyModule)()
    told = [key for key in QUANTITIES if key in rule.in_keys]
    world = WorldConfig(size=(14, 12), obstacles=3, min_goal_distance=5.0)
    base = NavigationEnv(2, world=world, privileged=told, seed=0)
    env = TransformedEnv(base, InitTracker() if isinstance(rule, Planner) else NavigationState())
    flown = env.rollout(2, rule)
    assert flown["action"].shape == (2, 2, 4)
    assert flown["action"].norm(dim=-1).min() > 0.1


def passing(*objects: tuple[float, ...], **told: float) -> list[float]:
    """The action of the rule that is told of moving objects, in free air, flying ahead at 2 m/s."""
    rule = VectorFieldHistogram(reduction="range_image", statistic="proximity", motion=12.0, **told)
    state = {
        "faces": torch.zeros(1, 72),
        "heading_deg": torch.zeros(1, 1),
        "altitude": torch.full((1, 1), 3.5),
        "velocity": torch.tensor([[0.0, 2.0, 0.0]]),  # in world axes: the vehicle looks along y
        "attitude": torch.tensor([[0.0, 0.0, torch.pi / 2]]),
        "moving_objects": torch.tensor([list(objects) + [(0.0,) * 7] * (3 - len(objects))]).reshape(1, 21),
    }
    return rule(TensorDict(state, [1]))["action"][0].tolist()


def test_told_of_nothing_that_moves_it_flies_as_ever() -> None:
    assert passing() == pytest.approx([2.0, 0.0, 0.0, 0.0], abs=1e-5)


def test_it_keeps_out_of_the_way_of_what_will_cross_and_lets_the_rest_pass() -> None:
    meets = (3.0, 4.5, 0.0, 0.0, -3.0, 0.0, 1.0)  # both are at (3, 0) after 1.5 s
    forward, left, up, _ = passing(meets)
    assert abs(forward - 2.0) + abs(left) + abs(up) > 0.5
    leaves = (3.0, 4.5, 0.0, 0.0, 3.0, 0.0, 1.0)
    above = (3.0, 4.5, 2.5, 0.0, -3.0, 0.0, 1.0)
    assert passing(leaves, above) == pytest.approx([2.0, 0.0, 0.0, 0.0], abs=1e-5)


def test_the_rule_that_is_told_reads_what_moves() -> None:
    assert "moving_objects" not in VectorFieldHistogram().in_keys
    seen = {"reduction": "range_image", "statistic": "proximity", "motion": 12.0}
    assert "moving_objects" in named_policy("vfh", {**seen, "radius": 4.0, "flight_level": 3.5}, []).in_keys


def test_the_rule_flies_as_fast_as_it_could_stop() -> None:
    fast = VectorFieldHistogram(radius=6.0, reduction="range_image", max_speed=6.0)
    faces = torch.zeros(72)
    assert flown(fast, faces)[0] == pytest.approx(6.0, abs=0.05)  # 6 m of free space: it could stop after 5.1 m
    faces[torch.arange(72) // 3 % 24 < 2] = 6.0 - 2.5  # something 2.5 m ahead and to the left
    near = flown(fast, faces)
    assert torch.tensor(near[:3]).norm() < 6.0
    speeds = fast._fastest(faces[None])
    assert isinstance(speeds, torch.Tensor)
    ahead = (fast.directions @ torch.tensor([1.0, 0.0, 0.0])) > 0.99
    stops = speeds[0, ahead] ** 2 / (2 * DECELERATION) + REACTION * speeds[0, ahead]
    assert (stops <= 2.5 - 0.35).all() and (speeds[0, ahead] >= 2.0).all()
    assert VectorFieldHistogram(reduction="range_image")._fastest(faces[None]) == 2.0
