from __future__ import annotations

from collections import deque

import numpy as np
import pybullet as p
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial import cKDTree

from uavrl.envs.mesh import Mesh
from uavrl.envs.obstacles import KINDS, make_obstacle
from uavrl.envs.shapes import blob, icosphere, loft, signed_volume
from uavrl.envs.tasks import enclosed, flight_map, largest_part, surface_points
from uavrl.envs.terrain import HeightField, valley_ground
from uavrl.envs.world import World, WorldConfig, build_valley

LIDAR_RANGE = 100.0  # m
LEVEL = 3.5  # m


@pytest.fixture(scope="module", autouse=True)
def valleys_built_once() -> None:
    """Not here: the building is what these tests are about."""


@pytest.fixture(scope="module")
def world() -> World:
    return World(WorldConfig(seeds=(0, 1)))


@pytest.fixture(scope="module")
def tasks(world):
    rng = np.random.default_rng(5)
    return [world.sample_task(rng) for _ in range(60)]


@pytest.fixture(scope="module")
def physics(world):
    client = BulletClient(p.DIRECT)
    bodies = []
    for mesh in world.meshes:
        shape = client.createCollisionShape(
            p.GEOM_MESH,
            vertices=mesh.vertices.tolist(),
            indices=mesh.faces.ravel().tolist(),
            flags=p.GEOM_FORCE_CONCAVE_TRIMESH,
        )
        assert shape >= 0
        bodies.append(client.createMultiBody(0, shape))
    yield client, bodies
    client.disconnect()


def embree(meshes) -> EmbreeScene:
    scene = EmbreeScene()
    for mesh in meshes:
        TriangleMesh(scene, mesh.vertices, mesh.faces)
    return scene


def cast(scene, origins, directions, length=LIDAR_RANGE) -> np.ndarray:
    distances = np.full(len(origins), length, dtype=np.float32)
    found = scene.run(
        np.ascontiguousarray(origins, np.float32),
        np.ascontiguousarray(directions, np.float32),
        distances,
        query="DISTANCE",
    )
    return np.asarray(found if found is not None else distances)


def point_triangle_distance(point: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Exact least distance of a point to triangles [F, 3]: to their planes where it projects inside, else to edges."""
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = ((point - a) * normal).sum(1)
    foot = point - height[:, None] * normal
    inside = np.ones(len(a), dtype=bool)
    best = np.inf
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(end - start, foot - start) * normal).sum(1) >= 0
        edge = end - start
        share = (((point - start) * edge).sum(1) / (edge * edge).sum(1)).clip(0, 1)
        best = min(best, np.linalg.norm(point - start - share[:, None] * edge, axis=1).min())
    return min(best, np.abs(height[inside]).min(initial=np.inf))


# --- building ---------------------------------------------------------------------------------------------------


def test_same_seed_same_world():
    first, second = (World(WorldConfig(seeds=(7,))) for _ in range(2))
    assert len(first.meshes) == len(second.meshes)
    for one, other in zip(first.meshes, second.meshes, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
        np.testing.assert_array_equal(one.faces, other.faces)


def test_building_ignores_and_keeps_the_global_random_state():
    np.random.seed(1)  # noqa: NPY002
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    build_valley(WorldConfig(), 0, np.zeros(2))
    np.testing.assert_array_equal(state, np.random.get_state()[1])  # noqa: NPY002


def test_different_seeds_differ(world):
    one, other = world.valleys
    assert np.abs(one.ground.heights - other.ground.heights).max() > 0.3
    places = [np.array([o.position for o in valley.obstacles]) for valley in (one, other)]
    assert np.abs(places[0] - places[1]).max() > 1.0


def test_valley_does_not_depend_on_its_neighbours(world):
    alone = World(WorldConfig(seeds=(1,))).valleys[0]
    np.testing.assert_array_equal(alone.ground.heights, world.valleys[1].ground.heights)
    np.testing.assert_array_equal(alone.flight.candidates, world.valleys[1].flight.candidates)


def test_valleys_are_out_of_each_others_lidar_range():
    world = World(WorldConfig(seeds=(0, 1, 2), obstacles=10))
    boxes = []
    for valley in world.valleys:
        vertices = np.concatenate([mesh.vertices for mesh in valley.meshes()])[:, :2]
        boxes.append((vertices.min(0), vertices.max(0)))
    assert sum(len(valley.meshes()) for valley in world.valleys) == len(world.meshes)
    for i in range(3):
        for j in range(i):
            gap = np.maximum(boxes[i][0] - boxes[j][1], boxes[j][0] - boxes[i][1])
            assert np.linalg.norm(gap.clip(0)) > LIDAR_RANGE


def test_scene_is_small_enough_for_physics_and_lidar(world):
    assert sum(len(mesh.faces) for mesh in world.valleys[0].meshes()) < 40_000
    assert max(mesh.faces.size for mesh in world.meshes) <= 32_768  # indices per mesh, PyBullet's limit on macOS
    assert max(len(mesh.vertices) for mesh in world.meshes) <= 8_192


# --- terrain ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_floor_is_flat_enough_and_walls_tower_over_the_flight_level(seed):
    heights = valley_ground(np.random.default_rng(seed), (40.0, 30.0)).heights
    assert heights.shape == (101, 76)
    assert np.abs(heights[9:-9, 9:-9]).max() <= 0.5
    assert np.ptp(heights[9:-9, 9:-9]) > 0.5
    border = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
    assert border.min() > LEVEL + 2.0


def test_ground_height_is_the_surface_that_rays_hit(world):
    rng = np.random.default_rng(0)
    for valley in world.valleys:
        xy = valley.origin + rng.uniform(-1, 1, (500, 2)) * (19.9, 14.9)
        scene = embree([tile.translated((*valley.origin, 0.0)) for tile in valley.ground.tiles()])
        down = cast(scene, np.column_stack([xy, np.full(500, 20.0)]), np.tile([0.0, 0.0, -1.0], (500, 1)))
        np.testing.assert_allclose(world.ground_height(xy), 20.0 - down, atol=1e-3)


# --- obstacles --------------------------------------------------------------------------------------------------


def parts(mesh: Mesh):
    """Splits a mesh into its connected parts."""
    owner = np.arange(len(mesh.vertices))
    while True:
        lowest = owner[mesh.faces].min(1)
        before = owner.copy()
        for corner in range(3):
            np.minimum.at(owner, mesh.faces[:, corner], lowest)
        if (before == owner).all():
            break
    label = owner[mesh.faces[:, 0]]
    return [Mesh(mesh.vertices, mesh.faces[label == one]) for one in np.unique(label)]


def assert_closed(mesh: Mesh) -> None:
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert set(map(tuple, edges.tolist())) == {(b, a) for a, b in edges.tolist()}
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-5
    for part in parts(mesh):
        assert signed_volume(part) > 0


@pytest.mark.parametrize("kind", KINDS)
def test_obstacles_are_closed_and_cheap(kind):
    for seed in range(20):
        mesh = make_obstacle(np.random.default_rng(seed), kind)
        assert_closed(mesh)
        assert len(mesh.faces) <= 400
        assert mesh.vertices[:, 2].min() < -0.5


def test_shapes_turn_outwards_whichever_way_the_rings_turn():
    square = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    upper = square + np.array([0, 0, 2])
    for rings in (np.stack([square, upper]), np.stack([upper, square])):
        assert_closed(loft(rings))
        assert signed_volume(loft(rings)) == pytest.approx(4.0)
    assert signed_volume(icosphere(3)) == pytest.approx(4 / 3 * np.pi, rel=0.02)


def test_at_least_four_kinds_matter_at_flight_level(world):
    for valley in world.valleys:
        assert len(valley.obstacles) == 45
        tall = [o.kind for o in valley.obstacles if o.mesh.vertices[:, 2].max() > LEVEL + 0.2]
        assert len(set(tall)) >= 4
        assert len(tall) >= 0.85 * 45
        sizes = {kind: [o.radius for o in valley.obstacles if o.kind == kind] for kind in set(tall)}
        assert all(np.std(radii) > 0.01 for radii in sizes.values())


def test_arches_can_be_flown_through():
    for seed in range(20):
        mesh = KINDS["arch"](np.random.default_rng(seed))
        assert point_triangle_distance(np.array([0.0, 0.0, LEVEL]), *np.moveaxis(mesh.vertices[mesh.faces], 1, 0)) > 0.6


def test_density_and_scale_are_keys():
    few = World(WorldConfig(obstacles=10)).valleys[0].obstacles
    large = World(WorldConfig(obstacles=10, obstacle_scale=1.5)).valleys[0].obstacles
    assert len(few) == 10
    assert sum(o.radius for o in large) == pytest.approx(1.5 * sum(o.radius for o in few), rel=1e-4)
    assert World(WorldConfig(obstacles=0)).valleys[0].obstacles == []


# --- physics and LiDAR see the same ------------------------------------------------------------------------------


def test_pybullet_and_embree_agree(world, physics):
    client, _ = physics
    rng = np.random.default_rng(3)
    count = 4000
    valley = rng.integers(2, size=count)
    origins = np.array([v.origin for v in world.valleys])[valley] + rng.uniform(-1, 1, (count, 2)) * (17, 12)
    origins = np.column_stack([origins, rng.uniform(1.0, 6.0, count)])
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = client.rayTestBatch(origins.tolist(), (origins + LIDAR_RANGE * directions).tolist())
    oracle = np.array([hit[2] for hit in hits]) * LIDAR_RANGE
    seen = cast(embree(world.meshes), origins, directions)
    assert (oracle < LIDAR_RANGE).mean() > 0.6
    assert (np.abs(oracle - seen) < 0.01).mean() >= 0.999


# --- tasks ------------------------------------------------------------------------------------------------------


def test_tasks_keep_the_rules(world, tasks):
    for task in tasks:
        assert task.start.shape == task.goal.shape == (3,)
        assert task.start[2] == LEVEL and task.goal[2] == LEVEL
        assert np.linalg.norm((task.goal - task.start)[:2]) >= 10.0
        assert -np.pi <= task.yaw < np.pi
        assert task.world_seed == world.config.seeds[task.valley]
        both = np.stack([task.start, task.goal])
        assert not world.out_of_bounds(both, np.full(2, task.valley)).any()
    assert {task.valley for task in tasks} == {0, 1}
    assert np.std([task.yaw for task in tasks]) > 1.0
    starts = np.array([task.start[:2] - world.valleys[task.valley].origin for task in tasks])
    assert (np.ptp(starts, axis=0) > (25, 18)).all()


def test_starts_and_goals_keep_their_clearance_to_every_triangle(world, tasks):
    corners = []
    for valley in world.valleys:
        mesh = Mesh.merge(valley.meshes())
        corners.append(np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0))
    for task in tasks[:25]:
        for point in (task.start, task.goal):
            assert point_triangle_distance(point, *corners[task.valley]) >= 1.5


def test_every_task_is_solvable_for_a_ball_in_the_physics(world, tasks, physics):
    """A breadth-first search that asks PyBullet for contacts finds a way from one start to all other ends."""
    client, bodies = physics
    ball = client.createMultiBody(1, client.createCollisionShape(p.GEOM_SPHERE, radius=0.35))
    here = [task for task in tasks if task.valley == 0]
    assert len(here) > 10
    step = 0.25
    wanted = {tuple(np.round(end[:2] / step).astype(int).tolist()) for task in here for end in (task.start, task.goal)}
    near = [b for b in bodies if client.getAABB(b)[0][0] < 50 and client.getAABB(b)[0][1] < 50]
    assert len(near) == len(world.valleys[0].meshes())

    def free(cell):
        client.resetBasePositionAndOrientation(ball, (cell[0] * step, cell[1] * step, LEVEL), (0, 0, 0, 1))
        return not any(client.getClosestPoints(ball, body, 0.0) for body in near)

    first = next(iter(wanted))
    queue, known = deque([first]), {first}
    while queue and not wanted <= known:
        i, j = queue.popleft()
        for cell in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
            if cell not in known and free(cell):
                known.add(cell)
                queue.append(cell)
    client.removeBody(ball)
    assert wanted <= known
    assert len(known) * step**2 < 0.9 * 1200  # obstacles and walls did stop the search


def wall_piece(y_from: float, y_to: float) -> Mesh:
    """A wall at x = 4 m, 0.4 m thick and 6 m high."""
    outline = np.array([[3.8, 0, -1], [4.2, 0, -1], [4.2, 0, 6], [3.8, 0, 6]])
    return loft(np.stack([outline + np.array([0, y, 0]) for y in (y_from, y_to)]))


def test_pairs_on_two_sides_of_a_barrier_are_never_drawn():
    flat = HeightField(np.zeros((2, 2)), (40.0, 30.0))
    barrier = wall_piece(-16, 16)
    flight = flight_map(flat, barrier, LEVEL, 0.35, 1.5, 10.0)
    assert flight.candidates[:, 0].max() < 4 - 0.2 - 1.5
    assert len(flight.candidates) > 1000


def test_narrow_gap_does_not_join_two_sides():
    flat = HeightField(np.zeros((2, 2)), (40.0, 30.0))
    for gap, joined in ((0.6, False), (1.6, True)):
        halves = [wall_piece(-16, -gap / 2), wall_piece(gap / 2, 16)]
        flight = flight_map(flat, Mesh.merge(halves), LEVEL, 0.35, 1.5, 10.0)
        assert (flight.candidates[:, 0].max() > 6) == joined


def test_inside_of_a_hollow_rock_is_not_free():
    flat = HeightField(np.zeros((2, 2)), (20.0, 20.0))
    boulder = blob(np.random.default_rng(0), (9.0, 9.0, 9.0), roughness=0.05)  # most of the free cells are inside
    flight = flight_map(flat, boulder, LEVEL, 0.35, 0.5, 5.0)
    assert len(flight.candidates)
    assert np.linalg.norm(flight.candidates, axis=1).min() > 8.0
    inside = enclosed(
        icosphere(3).translated((1.0, 0.0, 0.0)), 0.003, np.arange(-3.0, 3, 0.11), np.arange(-3.0, 3, 0.11)
    )
    assert inside.sum() * 0.11**2 == pytest.approx(np.pi, rel=0.05)


def test_surface_points_leave_no_gap():
    rng = np.random.default_rng(0)
    mesh = Mesh(rng.uniform(-1, 1, (30, 3)), np.arange(30).reshape(-1, 3))
    weights = rng.dirichlet([1, 1, 1], 2000)
    samples = (weights @ mesh.vertices[mesh.faces]).reshape(-1, 3)
    assert cKDTree(surface_points(mesh, -2, 2)).query(samples)[0].max() <= 0.1 / 3**0.5


def test_largest_part_does_not_pass_corners():
    free = np.array([[1, 1, 0], [0, 0, 1], [0, 0, 1], [0, 0, 1]], dtype=bool)
    assert largest_part(free).sum() == 3
    assert largest_part(np.zeros((2, 2), dtype=bool)).sum() == 0


def test_free_space_hangs_together(world):
    for valley in world.valleys:
        free = valley.flight.clearance >= 0.45
        assert valley.flight.corridor.sum() >= 0.98 * free.sum()


def test_map_bounds_the_clearance_from_below(world):
    valley = world.valleys[0]
    mesh = Mesh.merge([*valley.ground.tiles(), *(o.mesh for o in valley.obstacles)])
    corners = np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0)
    flight = valley.flight
    near = np.argwhere((flight.clearance > 0) & (flight.clearance < 1.2))
    for i, j in np.random.default_rng(0).permutation(near)[:25]:
        exact = point_triangle_distance(np.array([flight.x[i], flight.y[j], LEVEL]), *corners)
        assert flight.clearance[i, j] <= exact + 1e-5 <= flight.clearance[i, j] + 0.1


def test_tasks_follow_the_generator(world):
    draw = [[world.sample_task(np.random.default_rng(seed)) for seed in (1, 1, 2)]][0]
    np.testing.assert_array_equal(draw[0].start, draw[1].start)
    np.testing.assert_array_equal(draw[0].goal, draw[1].goal)
    assert draw[0].yaw == draw[1].yaw
    assert not np.allclose(draw[0].start, draw[2].start)
    assert world.sample_task(np.random.default_rng(0), valley=1).valley == 1


@pytest.mark.parametrize("seed", range(3))
def test_flying_straight_at_the_goal_works_sometimes(seed):
    """Hard enough to need the LiDAR, easy enough to learn from: a quarter of the straight lines is free."""
    world = World(WorldConfig(seeds=(seed,)))
    near = cKDTree(surface_points(Mesh.merge(world.meshes), LEVEL - 1, LEVEL + 1))
    rng = np.random.default_rng(1)
    free = []
    for _ in range(300):
        task = world.sample_task(rng)
        line = task.goal - task.start
        length = np.linalg.norm(line)
        path = task.start + np.linspace(0, 1 - 1 / length, int(length / 0.05))[:, None] * line
        free.append(near.query(path, distance_upper_bound=1.0)[0].min() > 0.4)
    assert 0.15 <= np.mean(free) <= 0.35


def test_starts_keep_away_from_planes(world):
    rng = np.random.default_rng(0)
    planes = np.array([[0.0, 0.0, 3.5], [10.0, 8.0, 3.5], [-12.0, -5.0, 3.5]])
    starts = np.array([world.sample_task(rng, 0, avoid=planes).start for _ in range(200)])
    apart = np.linalg.norm(starts[:, None] - planes, axis=-1)
    assert 6.0 <= apart.min() < 7.0
    assert world.sample_task(rng, 0, avoid=np.zeros((0, 3))).valley == 0


def test_too_many_planes_to_start_are_refused(world):
    everywhere = np.stack(np.meshgrid(np.arange(-20.0, 21, 5), np.arange(-15.0, 16, 5), [3.5]), -1).reshape(-1, 3)
    with pytest.raises(ValueError, match="lower plane_keep_out"):
        world.sample_task(np.random.default_rng(0), 0, avoid=everywhere)


# --- the rules of the flight ------------------------------------------------------------------------------------


def test_out_of_bounds(world):
    origin = world.valleys[1].origin
    ground = world.ground_height(origin[None])[0]
    local = [
        (0, 0, 3.5),
        (0, 0, ground + 7.9),
        (0, 0, ground + 8.1),
        (19.9, 0, 9),
        (20.1, 0, 9),
        (0, -15.1, 9),
        (0, 15.1, 9),
    ]
    positions = np.array(local, dtype=float) + np.append(origin, 0.0)
    outside = [False, False, True, False, True, True, True]
    assert world.out_of_bounds(positions, np.ones(7, dtype=int)).tolist() == outside
    assert world.out_of_bounds(positions, np.zeros(7, dtype=int)).all()


def test_arrived(world):
    goal = np.array([[2.0, 1.0, 3.5]])
    offsets = np.array(
        [[0.99, 0, 0], [1.01, 0, 0], [0.8, 0.8, 0], [0, 0, 3.4], [0, 0, 3.6], [0, 0, -3.4], [0, 0, -3.6]]
    )
    expected = [True, False, False, True, False, True, False]
    assert world.arrived(goal + offsets, np.repeat(goal, 7, 0)).tolist() == expected


# --- mistakes in the config -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": ()}, "seeds"),
        ({"seeds": (-1,)}, "seeds"),
        ({"size": (40.0,)}, "size"),
        ({"size": (0.0, 30.0)}, "size"),
        ({"obstacles": -1}, "obstacles"),
        ({"obstacle_scale": 0.0}, "obstacle_scale"),
        ({"goal_radius": 0.0}, "goal_radius"),
        ({"goal_base": 5.0}, "goal cylinder"),
        ({"uav_radius": -0.35}, "uav_radius"),
        ({"min_clearance": -1.0}, "min_clearance"),
        ({"flight_level": 5.0, "ceiling": 4.0}, "ceiling"),
        ({"planes": -3}, "planes"),
        ({"plane_speed": (4.0, 2.5)}, "plane_speed"),
        ({"plane_speed": (0.0, 2.5)}, "plane_speed"),
    ],
)
def test_invalid_configs_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        WorldConfig(**change)


def test_lists_from_a_file_are_taken():
    assert WorldConfig(seeds=[0, 1], size=[40.0, 30.0]) == WorldConfig(seeds=(0, 1))


@pytest.mark.parametrize(
    "change", [{"min_goal_distance": 60.0}, {"min_clearance": 8.0}, {"size": (9.0, 9.0)}, {"uav_radius": 5.0}]
)
def test_worlds_without_a_task_are_refused(change):
    with pytest.raises(ValueError, match="start and a goal"):
        World(WorldConfig(**change))
