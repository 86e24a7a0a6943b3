"""Traps: what flies straight on is caught in them, what knows the map gets around, and without them nothing changes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from tests.helpers.geometry import assert_closed, cast, embree
from uavrl.config import compose, validate
from uavrl.envs.place import Place, free_space
from uavrl.envs.tasks import Task
from uavrl.envs.traps import KINDS, LONGEST_WAY, PASSAGE, SIGHT, along, pocket, ways_at
from uavrl.envs.world import World, WorldConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.policies import named_policy
from uavrl.evaluation.rollout import rollout_episodes
from uavrl_onboard.mesh import Mesh

LEVEL = 3.5  # m
TRAPPED = WorldConfig(seeds=(200, 201), obstacles=12, traps=3)


@pytest.fixture(scope="module")
def world() -> World:
    return World(TRAPPED)


@pytest.fixture(scope="module")
def tasks(world: World) -> list[Task]:
    rng = np.random.default_rng(1)
    return [world.sample_task(rng) for _ in range(60)]


def in_valley(world: World, task: Task) -> tuple[Place, np.ndarray, np.ndarray]:
    valley = world.places[task.place]
    return valley, task.start[:2] - valley.origin, task.goal[:2] - valley.origin


def test_without_traps_the_valley_is_that_of_before_there_were_any() -> None:
    """The geometry and the tasks that it had at commit 6ed3c95d."""
    world = World(WorldConfig(seeds=(200,)))
    rng, merged = np.random.default_rng(0), Mesh.merge(world.places[0].meshes())
    drawn = np.array([np.concatenate([task.start, task.goal]) for task in (world.sample_task(rng) for _ in range(8))])
    assert merged.vertices.shape == (14538, 3) and merged.faces.sum() == 613037682
    assert merged.vertices.mean(0, dtype=np.float64) == pytest.approx([0.7785, 0.5374, 1.6646], abs=1e-3)
    assert drawn[-1] == pytest.approx([9.084, -5.402, 3.5, -1.777, 4.307, 2.641], abs=2e-3)
    assert drawn.mean(0) == pytest.approx([1.639, -1.381, 3.5, 4.631, 0.255, 2.557], abs=2e-3)


def test_traps_of_all_kinds_stand_apart_and_inside(world: World) -> None:
    for valley in world.places:
        assert {trap.kind for trap in valley.traps} == {kind.__name__ for kind in KINDS}
        lines = [np.concatenate([along(line, 0.2) for line in trap.walls]) for trap in valley.traps]
        for i, one in enumerate(lines):
            assert (np.abs(one) < (20.0, 15.0)).all()
            for other in lines[:i]:
                assert np.linalg.norm(one[:, None] - other, axis=-1).min() > PASSAGE - 0.3


def test_walls_are_closed_stand_in_the_ground_and_end_over_the_ceiling(world: World) -> None:
    for valley in world.places:
        walls = [obstacle for obstacle in valley.obstacles if obstacle.kind in {kind.__name__ for kind in KINDS}]
        assert len(walls) == 3 and len(valley.obstacles) == 15
        for obstacle in walls:
            assert_closed(obstacle.mesh)
            assert obstacle.mesh.vertices[:, 2].min() < valley.ground.heights.min() - 1
            assert obstacle.mesh.vertices[:, 2].max() >= 0.5 + 5.0 + 1.0


def test_every_straight_line_ends_in_a_wall_that_the_lidar_sees_at_every_height(
    world: World, tasks: list[Task]
) -> None:
    scene = embree(world.meshes)
    for task in tasks:
        ahead = np.append((task.goal - task.start)[:2], 0.0)
        origins = np.array([[*task.start[:2], height] for height in (1.0, LEVEL, 4.9)])
        length = np.linalg.norm(ahead)
        assert (cast(scene, origins, np.tile(ahead / length, (3, 1))) < length).all()


def test_every_straight_line_meets_a_closed_side_from_within(world: World, tasks: list[Task]) -> None:
    for task in tasks:
        valley, start, goal = in_valley(world, task)
        assert any(trap.catches(start[None], goal[None])[0, 0] for trap in valley.traps)
    kinds = [
        {trap.kind for trap in valley.traps if trap.catches(start[None], goal[None])[0, 0]}
        for valley, start, goal in (in_valley(world, task) for task in tasks)
    ]
    assert set.union(*kinds) == {"u", "canyon", "gap"}


def test_the_map_has_a_way_around_that_is_longer_and_short_enough(world: World, tasks: list[Task]) -> None:
    for task in tasks[:12]:
        valley, start, goal = in_valley(world, task)
        flight = free_space(valley.config, valley.scene)
        graph, nodes = ways_at(flight, LEVEL, TRAPPED.uav_radius)
        first, last = (nodes[np.linalg.norm(flight.candidates - xy, axis=1).argmin()] for xy in (start, goal))
        way = float(dijkstra(graph, indices=first, limit=LONGEST_WAY + 1)[last])
        assert np.linalg.norm(goal - start) + 0.5 < way <= LONGEST_WAY + 1


def test_the_long_wall_has_one_gap_and_is_caught_by_only_where_that_is_not_seen() -> None:
    trap = KINDS[2](np.random.default_rng(3), (40.0, 30.0))
    (_, low), (high, _) = trap.walls
    assert trap.kind == "gap" and 2.0 < np.linalg.norm(high - low) - trap.thickness < 3.0
    middle = (low + high) / 2
    for past, caught in ((0.0, False), (np.linalg.norm(high - low) / 2 + SIGHT + 1.0, True)):
        y = middle[1] - np.sign(middle[1]) * past
        starts, goals = np.array([[middle[0] - 5, y]]), np.array([[middle[0] + 5, y]])
        assert trap.catches(starts, goals).all() == trap.catches(goals, starts).all() == caught


def test_a_pocket_catches_what_comes_in_by_its_mouth_alone() -> None:
    """Into it, out through its back, past it, and in through an arm."""
    trap = pocket("u", np.random.default_rng(0), 6.0, 5.0)
    starts = np.array([[-9.0, 0.0], [9.0, 0.0], [-9.0, 8.0], [0.0, 9.0], [0.0, 0.0]])
    goals = np.array([[9.0, 0.5], [-9.0, 0.5], [9.0, 8.0], [4.0, -1.0], [9.0, 1.0]])
    assert np.diag(trap.catches(starts, goals)).tolist() == [True, False, False, False, True]


def test_valleys_take_numbers_of_traps_in_turn() -> None:
    mixed = World(WorldConfig(seeds=(200, 201), obstacles=[20, 12], traps=[0, 3]))  # type: ignore[arg-type]
    assert [len(place.traps) for place in mixed.places] == [0, 3]
    assert not mixed.places[0].trapped and mixed.places[1].trapped
    alone = World(WorldConfig(seeds=(201,), obstacles=12, traps=3)).places[0]
    for one, other in zip(mixed.places[1].obstacles, alone.obstacles, strict=True):
        np.testing.assert_array_equal(one.mesh.vertices, other.mesh.vertices)
    with pytest.raises(ValueError, match="traps takes a number, or a list that the valleys take in turn"):
        WorldConfig(traps=())
    with pytest.raises(ValueError, match="planes have no lanes between traps"):
        WorldConfig(traps=(0, 1), planes=1)


def test_too_many_traps_are_refused() -> None:
    with pytest.raises(UavrlError, match="lower traps or enlarge size"):
        World(WorldConfig(size=(14.0, 12.0), obstacles=0, traps=1, min_goal_distance=4.0))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("vfh", "timed_out"), ("vfh_mapped", "arrived")])
def test_a_controller_without_memory_stays_in_a_u_that_one_with_a_map_leaves(name: str, most: str) -> None:
    """The empty valley holds nothing but the U, and the way around it is short enough."""
    cells = ["perception=range_image", "perception.last_action=true"]
    world = ["env.world.seeds=[200]", "env.world.traps=1", "env.world.obstacles=0", "env.max_steps=250"]
    chosen = validate(compose(*cells, *world))
    policy = named_policy(name, {**chosen.perception, "flight_level": LEVEL}, ())
    env = make_env(chosen.env, chosen.perception, num_uavs=6, policy_reads=policy.in_keys)
    try:
        outcomes = [flight.outcome for flight in rollout_episodes(env, policy, 6)]
    finally:
        env.close()
    assert outcomes.count(most) >= 4
