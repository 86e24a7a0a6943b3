from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.geometry import LIDAR_RANGE, bullet_world, cast, embree
from uavrl.envs.terrain import valley_ground
from uavrl.envs.world import World, WorldConfig, build_place

CEILING = 5.0  # m above ground


@pytest.fixture(scope="module", autouse=True)
def valleys_built_once() -> None:
    """Not here: the building is what these tests are about."""


@pytest.fixture(scope="module")
def world() -> World:
    return World(WorldConfig(seeds=(0, 1)))


def test_same_seed_same_world():
    first, second = (World(WorldConfig(seeds=(7,))) for _ in range(2))
    assert len(first.meshes) == len(second.meshes)
    for one, other in zip(first.meshes, second.meshes, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
        np.testing.assert_array_equal(one.faces, other.faces)
    other = World(WorldConfig(seeds=(8,))).places[0]
    assert np.abs(first.places[0].ground.heights - other.ground.heights).max() > 0.3


def test_building_ignores_and_keeps_the_global_random_state():
    np.random.seed(1)  # noqa: NPY002
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    build_place(WorldConfig(), 0, np.zeros(2))
    np.testing.assert_array_equal(state, np.random.get_state()[1])  # noqa: NPY002


def test_valleys_are_out_of_each_others_lidar_range():
    world = World(WorldConfig(seeds=(0, 1, 2), obstacles=10))
    boxes = []
    for valley in world.places:
        vertices = np.concatenate([mesh.vertices for mesh in valley.meshes()])[:, :2]
        boxes.append((vertices.min(0), vertices.max(0)))
    assert sum(len(valley.meshes()) for valley in world.places) == len(world.meshes)
    for i in range(3):
        for j in range(i):
            gap = np.maximum(boxes[i][0] - boxes[j][1], boxes[j][0] - boxes[i][1])
            assert np.linalg.norm(gap.clip(0)) > LIDAR_RANGE


def test_scene_is_small_enough_for_physics_and_lidar(world):
    assert sum(len(mesh.faces) for mesh in world.places[0].meshes()) < 40_000
    assert max(mesh.faces.size for mesh in world.meshes) <= 32_768  # indices per mesh, PyBullet's limit on macOS
    assert max(len(mesh.vertices) for mesh in world.meshes) <= 8_192


@pytest.mark.parametrize("seed", range(4))
def test_floor_is_flat_enough_and_walls_tower_over_the_ceiling(seed):
    heights = valley_ground(np.random.default_rng(seed), (40.0, 30.0)).heights
    assert heights.shape == (101, 76)
    assert np.abs(heights[9:-9, 9:-9]).max() <= 0.5
    assert np.ptp(heights[9:-9, 9:-9]) > 0.5
    border = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
    assert border.min() > CEILING + 0.5


def test_ground_height_is_the_surface_that_rays_hit(world):
    rng = np.random.default_rng(0)
    for valley in world.places:
        xy = valley.origin + rng.uniform(-1, 1, (500, 2)) * (19.9, 14.9)
        scene = embree([tile.translated((*valley.origin, 0.0)) for tile in valley.ground.tiles()])
        down = cast(scene, np.column_stack([xy, np.full(500, 20.0)]), np.tile([0.0, 0.0, -1.0], (500, 1)))
        np.testing.assert_allclose(world.ground_height(xy), 20.0 - down, atol=1e-3)


def test_pybullet_and_embree_agree(world):
    client, _ = bullet_world(world.meshes)
    rng = np.random.default_rng(3)
    count = 4000
    valley = rng.integers(2, size=count)
    origins = np.array([v.origin for v in world.places])[valley] + rng.uniform(-1, 1, (count, 2)) * (17, 12)
    origins = np.column_stack([origins, rng.uniform(1.0, 6.0, count)])
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = client.rayTestBatch(origins.tolist(), (origins + LIDAR_RANGE * directions).tolist())
    client.disconnect()
    oracle = np.array([hit[2] for hit in hits]) * LIDAR_RANGE
    seen = cast(embree(world.meshes), origins, directions)
    assert (oracle < LIDAR_RANGE).mean() > 0.6
    assert (np.abs(oracle - seen) < 0.01).mean() >= 0.999


def test_out_of_bounds(world):
    origin = world.places[1].origin
    ground = world.ground_height(origin[None])[0]
    heights = [(0, 0, 3.5), (0, 0, ground + 4.9), (0, 0, ground + 5.1)]
    edges = [(19.9, 0, 9), (20.1, 0, 9), (0, -15.1, 9), (0, 15.1, 9)]
    positions = np.array([*heights, *edges], dtype=float) + np.append(origin, 0.0)
    outside = [False, False, True, False, True, True, True]
    assert world.out_of_bounds(positions, np.ones(7, dtype=int)).tolist() == outside
    assert world.out_of_bounds(positions, np.zeros(7, dtype=int)).all()


def test_arrived_is_at_any_height_within_the_radius(world):
    goal = np.array([[2.0, 1.0, 2.5]])
    offsets = np.array([[0.99, 0, 0], [1.01, 0, 0], [0.8, 0.8, 0], [0.6, -0.7, 2.4], [-0.9, 0, -2.4], [0, 1.1, 2.4]])
    expected = [True, False, False, True, True, False]
    assert world.arrived(goal + offsets, np.repeat(goal, 6, 0)).tolist() == expected


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": ()}, "seeds"),
        ({"seeds": (-1,)}, "seeds"),
        ({"size": (40.0,)}, "size"),
        ({"size": (0.0, 30.0)}, "size"),
        ({"obstacles": -1}, "obstacles"),
        ({"obstacles": (10, -1)}, "obstacles"),
        ({"obstacles": ()}, "obstacles"),
        ({"obstacle_scale": 0.0}, "obstacle_scale"),
        ({"goal_radius": 0.0}, "goal_radius"),
        ({"uav_radius": -0.35}, "uav_radius"),
        ({"min_clearance": -1.0}, "min_clearance"),
        ({"flight_level": 5.0, "ceiling": 4.0}, "ceiling"),
        ({"planes": -3}, "planes"),
        ({"traps": -1}, "traps"),
        ({"traps": 1, "planes": 1}, "no lanes between traps"),
        ({"plane_speed": (4.0, 2.5)}, "plane_speed"),
        ({"plane_speed": (0.0, 2.5)}, "plane_speed"),
    ],
)
def test_invalid_configs_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        WorldConfig(**change)


def test_lists_from_a_file_are_taken():
    assert WorldConfig(seeds=[0, 1], size=[40.0, 30.0]) == WorldConfig(seeds=(0, 1))
    assert WorldConfig(obstacles=[5, 9]) == WorldConfig(obstacles=(5, 9))


@pytest.mark.parametrize(
    "change", [{"min_goal_distance": 60.0}, {"min_clearance": 8.0}, {"size": (9.0, 9.0)}, {"uav_radius": 5.0}]
)
def test_worlds_without_a_task_are_refused(change):
    with pytest.raises(ValueError, match="start and a goal"):
        World(WorldConfig(**change))
