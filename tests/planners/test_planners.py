"""Planners with memory, which the learned policies are compared with: what they see, remember, avoid and forget."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from uavrl.config import EvaluateConfig, compose, validate
from uavrl.config.build import find_class
from uavrl.envs import Airframe
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.policies import BASELINES, named_policy
from uavrl.evaluation.policy_setup import choose
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.planners.mppi import MPPI, STEPS, MPPIWeights, places_of
from uavrl.planners.point_memory import PERIOD, THINNED, Planner, ScanMemory
from uavrl.planners.potential_field import FieldWeights, PotentialField
from uavrl.planners.vfh_star import VFHStar, VFHStarWeights, look_along
from uavrl_onboard.guards.histogram import polar_histogram
from uavrl_onboard.perception.cells import LASERS
from uavrl_onboard.vehicle import VEHICLE

Rival = Callable[[TensorDictBase], TensorDictBase]
PLANNERS = ("vfh_star", "mppi")
WITH_OMPL = ["rrt_connect", "rrt_map"] * bool(find_spec("ompl"))  # some machines have no wheel of it
RIVALS = (*PLANNERS, "potential_field", *WITH_OMPL)


def kind(name: str) -> type[torch.nn.Module]:
    return find_class(BASELINES[name], torch.nn.Module)


def grid(x: float, left: tuple[float, float], up: tuple[float, float] = (-0.7, 0.7)) -> torch.Tensor:
    """Points of a wall across the way: ``[P, 3]``."""
    y, z = torch.arange(*left, 0.1), torch.arange(*up, 0.1)
    return torch.stack(
        [torch.full((len(y) * len(z),), x), *(each.flatten() for each in torch.meshgrid(y, z, indexing="ij"))], -1
    )


def scan(points: torch.Tensor) -> torch.Tensor:
    """A scan ``[R, 3]`` of points given from the hull's middle, as a sensor gives it that is read thinly."""
    points = points - torch.tensor([0.0, 0.0, VEHICLE.lidar_above])
    full = torch.full((LASERS * 64, 3), torch.nan)
    full[: len(points)] = points
    return full.unflatten(0, (-1, LASERS)).repeat_interleave(THINNED, 0).flatten(0, 1)


def seen(*clouds: torch.Tensor, fresh: bool = False, **told: Any) -> TensorDict:
    """What vehicles read that stand at the flight level, with the goal ahead."""
    count = len(clouds)
    state = {
        "point_cloud": torch.stack(clouds),
        "is_init": torch.full((count, 1), fresh),
        "altitude": torch.full((count, 1), 3.5),
        "heading_deg": torch.zeros(count, 1),
        "velocity": torch.zeros(count, 3),
        "attitude": torch.zeros(count, 3),
    }
    return TensorDict(state | told, [count])


def flown(rival: Rival, obstacles: torch.Tensor, steps: int) -> np.ndarray:
    """Where a vehicle comes to from the origin, whose velocity follows its commands with a lag: ``[T, 3]`` m."""
    place, velocity, path = torch.zeros(3), torch.zeros(3), []
    for step in range(steps):
        apart = obstacles - place
        near = apart[apart.norm(dim=-1) < 4.0][: LASERS * 64]
        state = seen(scan(near), fresh=step == 0, velocity=velocity[None], altitude=3.5 + place[None, 2:])
        velocity = velocity + 0.22 * (rival(state)["action"][0, :3] - velocity)
        place = place + 0.1 * velocity
        path.append(place.numpy())
    return np.stack(path)


@pytest.mark.parametrize("name", RIVALS)
def test_they_are_chosen_like_any_other_policy(name: str) -> None:
    rival = named_policy(name, {"flight_level": 3.0, "radius": 5.0, "reduction": "range_image", "frames": 3}, ())
    assert isinstance(rival, kind(name)) and isinstance(rival, Planner)
    assert {"point_cloud", "is_init"} <= set(rival.in_keys)
    assert (rival.vehicle.flight_level, rival.memory.sight) == (3.0, 5.0)


@pytest.mark.parametrize("name", RIVALS)
def test_they_reckon_with_the_hull_and_the_lidar_of_the_environments_vehicle(name: str) -> None:
    told = [f"policy={name}", "env.airframe.collision_radius=0.4", "env.airframe.collision_height=0.3"]
    told.append("env.airframe.lidar_position=[0.0,0.0,0.13]")
    config = compose(*told, name="evaluate")
    chosen: Any = choose(validate(config, EvaluateConfig), config, told, None, torch.device("cpu")).policy
    assert (chosen.vehicle.hull, chosen.memory.above) == ((0.4, 0.15), 0.13)
    default = kind(name)()
    assert (default.vehicle.hull, default.memory.above) == (VEHICLE.hull, VEHICLE.lidar_above)


@pytest.mark.parametrize("name", RIVALS)
def test_a_wider_vehicle_keeps_farther_from_a_wall(name: str) -> None:
    wall = grid(2.0, (-1.5, 1.5))
    narrow, wide = (flown(kind(name)(airframe=Airframe(collision_radius=radius)), wall, 12) for radius in (0.2, 0.7))
    assert (2.0 - wide[:, 0]).min() > (2.0 - narrow[:, 0]).min() + 0.1


@pytest.mark.parametrize("name", PLANNERS)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_wall_with_a_gap_is_passed_through_the_gap(name: str, side: float) -> None:
    """The wall reaches 0.7 m to the gap's side of the straight way, and 4 m to the other."""
    wall = grid(2.5, (-4.0, 0.7), (-1.5, 1.5)) * torch.tensor([1.0, side, 1.0])
    path = flown(kind(name)(), wall, 45)
    assert path[-1, 0] > 3.0
    passing = path[np.abs(path[:, 0] - 2.5) < 0.35]
    assert (side * passing[:, 1] > 0.7 + 0.3).all()


@pytest.mark.parametrize("name", RIVALS)
def test_it_flies_ahead_where_nothing_is_and_returns_to_the_flight_level(name: str) -> None:
    path = flown(kind(name)(), torch.zeros(0, 3), 30)
    assert path[-1, 0] > 4.0 and np.abs(path[:, 1:]).max() < 0.6


@pytest.mark.parametrize("name", RIVALS)
@pytest.mark.parametrize(("altitude", "way"), [(5.0, -1), (1.5, 1)])
def test_it_flies_back_to_the_flight_level(name: str, altitude: float, way: int) -> None:
    rival, nothing = kind(name)(), scan(torch.zeros(0, 3))
    for step in range(3):
        action = rival(seen(nothing, fresh=step == 0, altitude=torch.tensor([[altitude]])))["action"]
    assert way * action[0, 2] > 0.2


@pytest.mark.parametrize("name", RIVALS)
def test_what_is_out_of_sight_still_repels_until_the_episode_ends(name: str) -> None:
    """A sill lies ahead, below the field of view: what a vehicle has seen of it keeps it away, each its own."""
    sill = scan(grid(0.6, (-0.8, 0.8), (-0.25, -0.15)))
    nothing = torch.full_like(sill, torch.nan)
    rival, other = (kind(name)(seconds=2.0) for _ in range(2))
    rival(seen(sill, nothing, fresh=True))
    first, second = rival(seen(nothing, nothing))["action"]
    assert (first - second).norm() > 0.3
    state = seen(nothing, nothing)
    state["is_init"][0] = True  # the first one's next episode begins
    forgot, went_on = rival(state)["action"]
    other(seen(nothing, nothing, fresh=True)), other(seen(nothing, nothing))
    assert torch.allclose(went_on, other(seen(nothing, nothing))["action"][1])
    assert torch.allclose(forgot, kind(name)()(seen(nothing, fresh=True))["action"][0])


@pytest.mark.parametrize("name", RIVALS)
def test_vehicles_do_not_know_of_each_other_and_stay_within_the_limits(name: str) -> None:
    generator = torch.Generator().manual_seed(3)
    clouds = 2.5 * torch.randn(3, 3, 100, 3, generator=generator)
    velocity = torch.randn(3, 3, 3, generator=generator)
    heading, yaw = 360 * torch.rand(3, 3, 1, generator=generator), torch.randn(3, 3, 3, generator=generator)
    yaw[..., :2] *= 0.2

    def acts(vehicles: list[int]) -> torch.Tensor:
        rival, actions = kind(name)(), []
        for step in range(3):
            state = seen(*(scan(clouds[step, one]) for one in vehicles), attitude=yaw[step, vehicles])
            state["velocity"], state["heading_deg"] = velocity[step, vehicles], heading[step, vehicles]
            state["is_init"][:] = torch.tensor([[step == 0 or (step == 2 and one == 1)] for one in vehicles])
            actions.append(rival(state)["action"])
        return torch.stack(actions)

    together = acts([0, 1, 2])
    assert together.isfinite().all() and together.abs().max() <= 2.0
    alone = torch.cat([acts([one]) for one in range(3)], 1)
    assert torch.allclose(together, alone, atol=1e-4)


def test_mppi_samples_by_its_own_seed_alone() -> None:
    state = seen(scan(grid(2.0, (-1.0, 0.5))), fresh=True)
    before = torch.get_rng_state()
    actions = [MPPI(seed=seed)(state.clone())["action"] for seed in (1, 1, 2)]
    assert torch.equal(before, torch.get_rng_state())
    assert torch.equal(actions[0], actions[1]) and not torch.equal(actions[0], actions[2])


def test_mppi_knows_where_commands_lead() -> None:
    """To the left, from 1 m/s ahead and while it is tilted to the right: late, and no faster than the tilt allows."""
    commands = torch.tensor([0.0, 2.0, 0.0]).expand(2, STEPS, 3)
    velocity = torch.tensor([[1.0, 0.0, 0.0]] * 2)
    tilted = torch.tensor([[0.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    level, right = places_of(commands, velocity, tilted)
    speeds = level.diff(dim=0) / PERIOD
    assert speeds[-1].tolist() == pytest.approx([0.0, 2.0, 0.0], abs=0.05)
    assert level[:, 1].diff(n=2).max() < 5.4 * PERIOD**2
    assert level[2, 1] < 0.5 * 2.0 * 0.3  # in 0.3 s
    assert (level[-1] - right[-1])[1] == pytest.approx(0.1 * (1 / 0.41 - 1) / 2.4, rel=0.1)


@pytest.mark.parametrize("costs", [MPPIWeights(), MPPIWeights(speed=1.0, climb=0.4)])
def test_mppi_flies_no_faster_than_its_samples(costs: MPPIWeights) -> None:
    post = scan(grid(1.2, (-3.0, 3.0), (-0.5, 0.3)))
    rival = MPPI(costs=costs)
    for step in range(5):
        action = rival(seen(post, fresh=step == 0))["action"][0]
        assert action[:2].norm() <= costs.speed + 1e-5 and action.abs().max() <= 2.0
        assert action[2].abs() <= costs.speed * costs.climb + 1e-5


def test_the_vehicles_own_speed_and_tilt_carry_it_on() -> None:
    """Whatever flies ahead and leans back comes to rest sooner; and all as its yaw points."""
    told: list[Any] = []

    class Watcher(Planner):
        def steer(self, seen: Any) -> tuple[torch.Tensor, torch.Tensor]:
            told.append(seen)
            return seen.velocity, seen.turn

    attitude = torch.tensor([[0.0, 0.0, np.pi / 2], [0.0, -0.2, np.pi / 2]])
    nothing = scan(torch.zeros(0, 3))
    Watcher(3.5, 4.0, 1.0)(
        seen(nothing, nothing, fresh=True, velocity=torch.tensor([[0.0, 2.0, 0.0]] * 2), attitude=attitude)
    )
    ahead, leaning = told[0].carried
    assert ahead.tolist() == pytest.approx([2 / 2.4, 0.0, 0.0], abs=1e-4)
    assert leaning.tolist() == pytest.approx(
        [(2 - 0.1 * (1 / 0.41 - 1) * 9.81 * np.tan(0.2)) / 2.4, 0.0, 0.0], abs=1e-3
    )


def test_a_potential_field_brakes_for_what_its_speed_carries_it_to() -> None:
    wall = scan(grid(1.7, (-1.0, 1.0)))
    strong = FieldWeights(attraction=2.0, repulsion=0.3, reach=1.5)
    still, fast = (
        PotentialField(costs=strong)(seen(wall, fresh=True, velocity=torch.tensor([[speed, 0.0, 0.0]])))["action"][0]
        for speed in (0.0, 2.0)
    )
    assert still[0] > 1.0 and fast[0] < 0.0


def test_they_fly_episode_after_episode_in_the_valley() -> None:
    small = ["env.world.size=[14,12]", "env.world.obstacles=3", "env.world.min_goal_distance=4", "env.max_steps=2"]
    chosen = validate(compose(*small))
    told = {**chosen.perception, "flight_level": chosen.env.world.flight_level}
    env = make_env(chosen.env, chosen.perception, num_uavs=2, keep_cloud=True, mark_resets=True)
    try:
        for name in RIVALS:
            env.set_seed(0)
            flights = rollout_episodes(env, named_policy(name, told, ()), 4)
            assert [flight.steps for flight in flights] == [2] * 4
    finally:
        env.close()


# ---------------------------------------------------------------------- memory


def look(
    memory: ScanMemory, points: list[list[float]], velocity: float = 0.0, yaw: float = 0.0, fresh: bool = False
) -> None:
    memory.look(
        np.asarray(points, np.float32)[None], np.array([[velocity, 0, 0]]), np.array([[0, 0, yaw]]), np.array([fresh])
    )


def test_memory_moves_with_the_vehicle_and_turns_with_its_yaw() -> None:
    memory = ScanMemory()
    look(memory, [[1.0, 0.0, 1.0]], velocity=1.0, yaw=np.pi / 2, fresh=True)
    look(memory, [[np.nan] * 3], velocity=1.0, yaw=0.3)
    look(memory, [[np.nan] * 3], velocity=1.0, yaw=-1.0)
    assert memory.recall()[0][0] == pytest.approx([-0.2, 1.0, 1.0 + VEHICLE.lidar_above], abs=1e-5)


def test_memory_takes_a_scan_from_where_its_lidar_sits() -> None:
    memory = ScanMemory(above=0.4)
    look(memory, [[1.0, 0.0, 1.0]], fresh=True)
    assert memory.recall()[0][0] == pytest.approx([1.0, 0.0, 1.4])


def test_memory_forgets_what_is_seen_through_and_what_is_old() -> None:
    above, level = [1.0, 0.0, 1.0], [2.0, 0.0, 0.0]
    memory = ScanMemory(seconds=1.0)
    look(memory, [above, level], fresh=True)
    look(memory, [[np.nan] * 3])
    points, owners = memory.recall()
    assert points.tolist() == [pytest.approx([1.0, 0.0, 1.0 + VEHICLE.lidar_above])] and owners.tolist() == [0]
    for _ in range(10):
        look(memory, [[np.nan] * 3])
    assert not len(memory.recall()[0])


def test_memory_keeps_what_is_hidden_behind_something_nearer() -> None:
    memory = ScanMemory()
    look(memory, [[3.0, 0.0, 0.0]], fresh=True)
    look(memory, [[1.0, 0.0, 0.0]])
    assert sorted(memory.recall()[0][:, 0].round(3).tolist()) == [1.0, 3.0]


def test_a_histogram_keeps_the_nearest_point_of_each_cell_and_vehicle() -> None:
    points = np.array([[2.0, 0.1, 0.1], [1.0, 0.05, 0.05], [-1.0, 0.1, 0.1], [0.0, 0.0, 2.0]])
    found = polar_histogram(points, np.array([0, 0, 0, 2]), 3)
    assert [sorted(each.tolist()) for each in found] == [
        [points[2].tolist(), points[1].tolist()],
        [],
        [points[3].tolist()],
    ]


# ---------------------------------------------------------------------- 3DVFH*


def test_lines_meet_what_is_as_near_as_the_hull_is_wide_and_high() -> None:
    costs, ahead = VFHStarWeights(near=0.15, reach=3.0), torch.tensor([[1.0, 0.0, 0.0]])
    for place, meets in [((0.42, 0.0), True), ((0.43, 0.0), False), ((0.0, 0.24), True), ((0.0, 0.25), False)]:
        lines = look_along(torch.tensor([[2.0, *place]]), torch.zeros(1, 1, 3), ahead, costs)
        assert lines.free.item() == pytest.approx(1.65 if meets else 3.0)
        assert lines.threat.item() > 0
    wide = look_along(torch.tensor([[2.0, 0.55, 0.0]]), torch.zeros(1, 1, 3), ahead, costs, hull=(0.5, 0.2))
    assert wide.free.item() == pytest.approx(1.5)
    behind = look_along(torch.tensor([[-0.4, 0.0, 0.0]]), torch.zeros(1, 1, 3), ahead, costs)
    assert (behind.threat.item(), behind.free.item()) == (0.0, 3.0)


def test_its_own_speed_carries_it_before_it_turns() -> None:
    """Flying fast to the left beside a post there, it does not fly as it would at rest."""
    post = scan(grid(1.0, (0.7, 1.0)))
    still, fast = (
        VFHStar()(seen(post, fresh=True, velocity=torch.tensor([[0.0, speed, 0.0]])))["action"][0]
        for speed in (0.0, 2.0)
    )
    assert fast[1] < still[1] - 0.2


def test_looking_ahead_tells_of_what_lies_beyond_the_first_lines() -> None:
    """A wall across the way begins 3.6 m ahead, which ends on the left; costs reach 3 m."""
    wall = scan(grid(3.6, (-1.6, 0.4), (-0.9, 0.9)))
    blind, far = (VFHStar(depth=depth)(seen(wall, fresh=True))["action"][0] for depth in (0, 2))
    assert blind.tolist() == pytest.approx([2.0, 0.0, 0.0, 0.0], abs=1e-5)
    assert far[1] > 0.1
