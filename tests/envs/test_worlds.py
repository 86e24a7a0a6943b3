"""Forest, rooms and a world of one's own: the same search finds their tasks, and vehicles collide and see there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.helpers.valleys import NEAR
from uavrl.config import EvaluateConfig, compose, resolve, validate
from uavrl.envs.difficulty import DifficultyMeter
from uavrl.envs.forest import MARGIN, ForestConfig
from uavrl.envs.mesh import decimated, icosphere
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.rooms import RoomsConfig, _doors
from uavrl.envs.rules import Scene, Solid, WorldRules
from uavrl.envs.traps import wall
from uavrl.envs.world import World
from uavrl.errors import UavrlError

FOREST = ForestConfig(seeds=(3,), size=(14.0, 12.0), density=300.0, min_goal_distance=5.0)
ROOMS = RoomsConfig(seeds=(3,), size=(12.0, 10.0), room=5.0, min_goal_distance=4.0)


@dataclass
class Screen(WorldRules):
    """A wall across the middle with a way around one end, in two facing orders of its corners."""

    flipped: bool = False

    def scene(self, number: int) -> Scene:
        mesh = wall(np.array([[0.0, -6.0], [0.0, 2.0]]), 0.02, -1.0, 8.0)
        faces = mesh.faces[:, ::-1] if self.flipped else mesh.faces
        return Scene([Solid("screen", type(mesh)(mesh.vertices, faces))], self.size)


SCREEN = Screen(size=(14.0, 12.0), min_goal_distance=5.0)


@pytest.fixture(scope="module")
def forest() -> World:
    return World(FOREST)


@pytest.fixture(scope="module")
def rooms() -> World:
    return World(ROOMS)


def test_a_forest_has_its_density_and_reaches_around_the_tasks(forest: World) -> None:
    (place,) = forest.places
    (trees,) = place.obstacles
    assert FOREST.trees == round(300 * (14 + 2 * MARGIN) * (12 + 2 * MARGIN) / 1e4)
    low, high = trees.mesh.vertices.min(0), trees.mesh.vertices.max(0)
    assert high[2] > FOREST.ceiling + 1 and low[2] < 0 and np.abs([low, high])[:, 0].max() > 10
    assert (np.abs(place.candidates) <= [7, 6]).all()
    edge = np.array([[7.0 + MARGIN - 0.1, 0, 3], [7.0 + MARGIN + 0.1, 0, 3], [0, 0, 5.1], [0, 0, -0.1]])
    assert forest.out_of_bounds(edge, np.zeros(4, int)).tolist() == [False, True, True, True]


def test_seeds_make_different_forests_that_repeat() -> None:
    one, again = (FOREST.scene(0).obstacles[0].mesh.vertices for _ in range(2))
    other = replace(FOREST, seeds=(4,)).scene(0).obstacles[0].mesh.vertices
    np.testing.assert_array_equal(one, again)
    assert one.shape != other.shape or np.abs(one - other).max() > 1


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("extra", [0.0, 0.4, 1.0])
def test_doors_join_all_rooms(seed: int, extra: float) -> None:
    doors = _doors(np.random.default_rng(seed), (4, 3), extra)
    reached, grown = {(0, 0)}, True
    while grown:
        more = {room for pair in doors if set(pair) & reached for room in pair}
        grown = not more <= reached
        reached |= more
    assert len(reached) == 12 and len(doors) >= 11
    assert len(doors) == {0.0: 11, 1.0: 17}.get(extra, len(doors))


def test_tasks_lead_through_doors(rooms: World) -> None:
    (place,) = rooms.places
    cells = {(float(x) > 0, float(y) > 0) for x, y in place.candidates}
    assert len(cells) == 4  # of 2 x 2 rooms, each has starts and goals, in one part of the free space
    tasks = [rooms.sample_task(np.random.default_rng(k)) for k in range(30)]
    meter = DifficultyMeter(place)
    detours = [meter.measure(task.start, task.goal) for task in tasks]
    assert all(each is not None and 1 <= each.detour < 5 and 0.7 <= each.spacing <= 6 for each in detours)
    assert max(each.detour for each in detours if each is not None) > 1.05


def test_a_world_of_one_s_own_is_seen_and_touched_from_both_sides() -> None:
    import torch

    for flipped in (False, True):
        env = NavigationEnv(2, world=replace(SCREEN, flipped=flipped), lidar=NEAR, max_steps=40)
        state = env.reset()
        starts = np.array([[-2.0, -3.0, 3.5], [2.0, -3.0, 3.5]])
        env.simulation.reset(np.arange(2), starts, np.array([0.0, np.pi]))
        nearest = np.nanmin(np.linalg.norm(env.look(slice(None)), axis=-1), axis=1)
        np.testing.assert_allclose(nearest, 1.99, atol=0.03)
        for _ in range(30):
            state["action"] = torch.tensor([[2.0, 0, 0, 0]] * 2)
            state = env.step(state)["next"]
            if state["collided"].any():
                break
        assert state["collided"].all() and np.abs(env.simulation.position[:, 0]).min() > 0.2
        env.close()


def test_the_way_around_is_longer_and_narrower() -> None:
    meter = DifficultyMeter(World(SCREEN).places[0])
    around = meter.measure(np.array([-3.0, -3.0]), np.array([3.0, -3.0]))
    free = meter.measure(np.array([-3.0, 4.5]), np.array([3.0, 4.5]))
    assert around is not None and free is not None
    assert free.detour == 1.0 and 1.5 < around.detour < 3.0 and around.spacing < free.spacing
    assert meter.measure(np.array([-3.0, 4.5]), np.array([-3.0, 4.5])) is None


def test_the_free_width_of_a_corridor_is_its_width() -> None:
    """The middle of the vehicle may be in 15 cells of 0.25 m: 3.75 m, and its hull of 0.35 m on either side."""
    (place,) = World(SCREEN).places
    fits = np.zeros((40, 40), bool)
    fits[:, 10:25] = True
    meter = DifficultyMeter(replace(place, fits=fits, corner=np.array([-5.0, -5.0]), origin=np.zeros(2)))
    found = meter.measure(np.array([-4.0, -5.0 + 17 * 0.25]), np.array([4.0, -5.0 + 17 * 0.25]))
    assert found is not None and found.detour == 1.0
    assert found.spacing == pytest.approx(4.45, abs=0.3)


def test_of_equally_short_ways_the_widest_is_measured(forest: World) -> None:
    """So the way back is as wide as the way there."""
    meter = DifficultyMeter(forest.places[0])
    there, back = [], []
    for number in range(40):
        task = forest.sample_task(np.random.default_rng(number))
        there.append(meter.measure(task.start, task.goal))
        back.append(meter.measure(task.goal, task.start))
    np.testing.assert_allclose(np.array(there, float), np.array(back, float), rtol=1e-9)
    (place,) = World(SCREEN).places
    fits = np.ones((40, 40), bool)
    fits[14:26, 24] = False  # beside the straight way
    meter = DifficultyMeter(replace(place, fits=fits, corner=np.array([-5.0, -5.0]), origin=np.zeros(2)))
    ends = np.array([[-4.0, 0.5], [4.0, -0.5]])
    one, other = meter.measure(*ends), meter.measure(*ends[::-1])
    assert one is not None and other is not None and one.detour == pytest.approx(1.0, abs=1e-9)
    assert one.spacing == pytest.approx(other.spacing)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ForestConfig(density=0.0), "density must be above 0"),
        (lambda: ForestConfig(density=20_000.0), "at most 3,000 trees, got"),
        (lambda: ForestConfig(trunk_radius=(0.3, 0.1)), "the least and the greatest radius"),
        (lambda: RoomsConfig(room=2.0), "has no room for a door of 2.2 m"),
        (lambda: RoomsConfig(door_height=9.0), "door_height must be at most the ceiling's 5.5 m, got 9.0 m"),
        (lambda: RoomsConfig(extra_doors=1.5), "a probability from 0 to 1"),
        (lambda: World(replace(FOREST, min_goal_distance=40.0)), "lower density, trunk_radius"),
    ],
)
def test_what_makes_no_world_is_told(make: object, message: str) -> None:
    with pytest.raises((UavrlError, ValueError), match=message):
        make()  # type: ignore[operator]


@pytest.mark.parametrize(("name", "kind"), [("forest", ForestConfig), ("rooms", RoomsConfig)])
def test_a_world_is_chosen_by_its_name_and_read_as_it_was_written(name: str, kind: type) -> None:
    config = compose(f"env={name}", "env.world.planes=0", "env.world.seeds=[1,2]")
    written = resolve(config)
    world = validate(written).env.world
    assert type(world) is kind and world.seeds == (1, 2) and written.env.world._target_.endswith(kind.__name__)
    assert type(validate(compose(f"env={name}", name="evaluate"), EvaluateConfig).env.world) is kind
    assert "_target_" not in resolve(compose("env=static")).env.world


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("env.world.density=none", "env.world.density"),
        ("env.world._target_=uavrl.envs.navigation.NavigationEnv", "must be a WorldRules"),
        ("env.world._target_=somebody.elses.World", "packages="),
    ],
)
def test_settings_of_a_named_world_are_checked(override: str, message: str) -> None:
    with pytest.raises(UavrlError, match=message):
        validate(compose("env=forest", override))


def test_a_picture_has_few_triangles_in_the_same_place() -> None:
    ball = icosphere(5)
    few = decimated(ball, 2000)
    assert len(few.faces) <= 2000 < len(ball.faces)
    np.testing.assert_allclose(np.linalg.norm(few.vertices, axis=1), 1.0, atol=1e-5)
    assert decimated(ball, len(ball.faces)).faces.shape == ball.faces.shape
