"""Tasks: every one has a corridor in three dimensions, shown by ways through it that are checked in the physics."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pybullet as p
import pytest
from pybullet_utils.bullet_client import BulletClient
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.spatial import cKDTree

from tests.helpers.geometry import bullet_world, point_triangle_distance
from uavrl.envs.mesh import blob, icosphere
from uavrl.envs.place import Place, free_space
from uavrl.envs.tasks import FlightMap, FreeSpace, Task, flight_map, surface_points
from uavrl.envs.terrain import HeightField
from uavrl.envs.world import World, WorldConfig
from uavrl_onboard.mesh import Mesh, loft

LEVEL, CEILING = 3.5, 5.0  # m
RADIUS = 0.35  # m, of the ball around a UAV
FLAT = HeightField(np.zeros((2, 2)), (20.0, 16.0))


@pytest.fixture(scope="module")
def world() -> World:
    return World(WorldConfig(seeds=(0, 1)))


@pytest.fixture(scope="module")
def tasks(world: World) -> list[Task]:
    rng = np.random.default_rng(5)
    return [world.sample_task(rng) for _ in range(60)]


@pytest.fixture(scope="module")
def physics(world: World) -> Iterator[tuple[BulletClient, list[int]]]:
    client, bodies = bullet_world(world.places[0].meshes())
    yield client, bodies
    client.disconnect()


def test_tasks_keep_the_rules(world: World, tasks: list[Task]) -> None:
    for task in tasks:
        assert task.start.shape == task.goal.shape == (3,)
        assert task.start[2] == LEVEL
        assert np.linalg.norm((task.goal - task.start)[:2]) >= 10.0
        assert -np.pi <= task.yaw < np.pi
        assert task.world_seed == world.config.seeds[task.place]
        both = np.stack([task.start, task.goal])
        assert not world.out_of_bounds(both, np.full(2, task.place)).any()
        assert task.goal[2] == pytest.approx(world.ground_height(task.goal[None, :2])[0] + CEILING / 2), "halfway up"
    assert {task.place for task in tasks} == {0, 1}
    assert np.std([task.yaw for task in tasks]) > 1.0
    starts = np.array([task.start[:2] - world.places[task.place].origin for task in tasks])
    assert (np.ptp(starts, axis=0) > (25, 18)).all()


def test_starts_and_goals_keep_their_clearance_at_flight_level_to_every_triangle(
    world: World, tasks: list[Task]
) -> None:
    corners = []
    for valley in world.places:
        mesh = Mesh.merge(valley.meshes())
        corners.append(np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0))
    for task in tasks[:20]:
        for point in (task.start, task.goal):
            assert point_triangle_distance(np.array([*point[:2], LEVEL]), *corners[task.place]) >= 1.5


def test_starts_keep_away_from_planes(world: World) -> None:
    rng = np.random.default_rng(0)
    planes = np.array([[0.0, 0.0, 3.5], [10.0, 8.0, 1.0], [-12.0, -5.0, 5.0]])
    starts = np.array([world.sample_task(rng, 0, avoid=planes).start for _ in range(200)])
    apart = np.linalg.norm(starts[:, None, :2] - planes[:, :2], axis=-1)
    assert 6.0 <= apart.min() < 7.0
    assert world.sample_task(rng, 1, avoid=np.zeros((0, 3))).place == 1
    everywhere = np.stack(np.meshgrid(np.arange(-20.0, 21, 5), np.arange(-15.0, 16, 5), [3.5]), -1).reshape(-1, 3)
    with pytest.raises(ValueError, match="lower plane_keep_out"):
        world.sample_task(rng, 0, avoid=everywhere)
    crowded = np.stack(np.meshgrid(np.arange(-20.0, 21, 6.5), np.arange(-15.0, 16, 6.5), [3.5]), -1).reshape(-1, 3)
    for _ in range(20):  # nowhere are 6 m left, and somewhere two thirds of that
        task = world.sample_task(rng, 0, avoid=crowded)
        assert 4.0 <= np.linalg.norm(task.start[:2] - crowded[:, :2], axis=1).min() < 6.0
        assert np.linalg.norm((task.start - task.goal)[:2]) >= world.config.min_goal_distance


@pytest.mark.parametrize("seed", range(3))
def test_flying_straight_at_the_goal_works_sometimes(seed: int) -> None:
    """Hard enough to need the LiDAR, easy enough to learn from: about a quarter of the straight lines is free."""
    world = World(WorldConfig(seeds=(seed,)))
    near = cKDTree(surface_points(Mesh.merge(world.meshes), LEVEL - 1, LEVEL + 1))
    rng = np.random.default_rng(1)
    free = []
    for _ in range(200):
        task = world.sample_task(rng)
        line = (task.goal - task.start) * [1, 1, 0]
        length = np.linalg.norm(line)
        path = task.start + np.linspace(0, 1 - 1 / length, int(length / 0.1))[:, None] * line
        free.append(near.query(path, distance_upper_bound=1.0)[0].min() > 0.4)
    assert 0.1 <= np.mean(free) <= 0.35


@pytest.mark.parametrize("seed", [0, 100])
@pytest.mark.parametrize("obstacles", [90, 135])
def test_dense_valleys_are_solvable(obstacles: int, seed: int) -> None:
    """Two and three times the default's obstacles: there are places, and room for flights in all directions."""
    valley = World(WorldConfig(obstacles=obstacles, seeds=(seed,))).places[0]
    assert len(free_space(valley.config, valley.scene).candidates) > 100
    assert (np.ptp(free_space(valley.config, valley.scene).candidates, axis=0) > (20.0, 12.0)).all()


def way_through(flight: FlightMap, starts: np.ndarray) -> list[np.ndarray]:
    """Ways ``[P, 3]`` between the first and each other of some places ``[S, 2]`` by straight pieces of the corridor."""
    space, inside = flight.space, flight.corridor
    index = np.arange(inside.size).reshape(inside.shape)
    pairs = []
    for axis, grid in enumerate((space.x, space.y, space.z)):
        low, high = np.arange(len(grid) - 1), np.arange(1, len(grid))
        joined = inside.take(low, axis) & inside.take(high, axis)
        room = space.clearance.take(low, axis) + space.clearance.take(high, axis) - (grid[1] - grid[0])
        joined &= room >= 2 * RADIUS
        pairs.append(np.stack([index.take(low, axis)[joined], index.take(high, axis)[joined]]))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(first)), (first, second)), (inside.size, inside.size)).tocsr()
    level = int(np.abs(space.z - LEVEL).argmin())
    nodes = [index[np.abs(space.x - x).argmin(), np.abs(space.y - y).argmin(), level] for x, y in starts]
    _, before = breadth_first_order(graph, nodes[0], directed=False)
    ways = []
    for node in nodes[1:]:
        way = [node]
        while way[-1] != nodes[0]:
            assert before[way[-1]] >= 0, "no way"
            way.append(before[way[-1]])
        ways.append(space.points.reshape(-1, 3)[way])
    return ways


def along(way: np.ndarray, step: float) -> np.ndarray:
    """Points at most ``step`` apart on a polyline ``[P, 3]``."""
    pieces = [np.linspace(a, b, int(np.ceil(np.linalg.norm(b - a) / step)) + 1) for a, b in pairwise(way)]
    return np.concatenate(pieces)


def test_every_task_is_joined_by_a_way_that_a_ball_flies_in_the_physics(
    world: World, tasks: list[Task], physics: tuple[BulletClient, list[int]]
) -> None:
    client, bodies = physics
    ball = client.createMultiBody(0, client.createCollisionShape(p.GEOM_SPHERE, radius=RADIUS - 1e-3))
    here = [task for task in tasks if task.place == 0][:12]
    ends = np.concatenate([[task.start[:2], task.goal[:2]] for task in here])
    flown = set()
    for end, way in zip(
        ends[1:], way_through(free_space(world.places[0].config, world.places[0].scene), ends), strict=True
    ):
        assert np.linalg.norm(way[0, :2] - end) <= 0.25  # the rest of the way is within the clearance of the end
        flown |= set(map(tuple, along(way, 0.1).round(6).tolist()))
    points = np.array(sorted(flown))
    assert not world.out_of_bounds(points, np.zeros(len(points), dtype=int)).any()
    assert (points[:, 2] > world.ground_height(points[:, :2])).all()
    for point in points:
        client.resetBasePositionAndOrientation(ball, point, (0, 0, 0, 1))
        assert not any(client.getClosestPoints(ball, body, 0.0) for body in bodies), point
    assert len(points) > 500
    below = np.random.default_rng(0).uniform(-12, 12, (20, 2))
    for point in np.column_stack([below, world.ground_height(below) + 0.2]):
        client.resetBasePositionAndOrientation(ball, point, (0, 0, 0, 1))
        assert any(client.getClosestPoints(ball, body, 0.0) for body in bodies), "the ball feels the geometry"


def barrier(*windows: tuple[float, float]) -> Mesh:
    """A wall at x = 4 m, 0.4 m thick and 9 m high, with windows from one height to another all along y."""
    edges = [-1.0, *(height for window in windows for height in window), 9.0]
    pieces = []
    for low, high in zip(edges[::2], edges[1::2], strict=True):
        outline = np.array([[3.8, 0, low], [4.2, 0, low], [4.2, 0, high], [3.8, 0, high]])
        pieces.append(loft(np.stack([outline + np.array([0, y, 0]) for y in (-12.0, 12.0)])))
    return Mesh.merge(pieces)


def mapped(obstacles: Mesh, clearance: float = 1.5, distance: float = 5.0) -> FlightMap:
    return flight_map(
        FLAT,
        obstacles,
        size=FLAT.size,
        level=LEVEL,
        ceiling=CEILING,
        uav_radius=RADIUS,
        min_clearance=clearance,
        min_distance=distance,
    )


@pytest.mark.parametrize(
    ("windows", "joined"),
    [((), False), (((0.6, 2.4),), True), (((1.2, 1.8),), False), (((5.2, 8.0),), False), (((3.9, 8.0),), True)],
    ids=["closed", "a low window", "a slit", "over the ceiling", "under the ceiling"],
)
def test_two_sides_of_a_barrier_are_joined_by_a_way_at_any_height_below_the_ceiling_and_by_no_other(
    windows: tuple[tuple[float, float], ...], joined: bool
) -> None:
    """At flight level itself the barrier is closed in all of them."""
    flight = mapped(barrier(*windows))
    assert len(flight.candidates) > 500
    assert (flight.candidates[:, 0].max() > 6) == joined
    assert not (np.abs(flight.candidates[:, 0] - 4) < 0.2 + 1.5).any()
    if joined:
        way = way_through(flight, np.array([[-2.0, 0.0], [8.0, 0.0]]))[0]
        height = np.interp(4.0, *way[np.argsort(way[:, 0], kind="stable")][:, [0, 2]].T)
        low, high = windows[0]
        assert low + RADIUS <= height <= min(high - RADIUS, CEILING)


@pytest.mark.parametrize(("gap", "joined"), [(0.6, False), (1.6, True)])
def test_a_narrow_gap_does_not_join_two_sides(gap: float, joined: bool) -> None:
    outline = np.array([[3.8, 0, -1], [4.2, 0, -1], [4.2, 0, 9], [3.8, 0, 9]])
    ends = ((-12.0, -gap / 2), (gap / 2, 12.0))
    halves = [loft(np.stack([outline + np.array([0, y, 0]) for y in pair])) for pair in ends]
    assert (mapped(Mesh.merge(halves)).candidates[:, 0].max() > 6) == joined


def test_inside_of_a_hollow_rock_is_not_free() -> None:
    rock = blob(np.random.default_rng(0), (6.0, 6.0, 9.0), roughness=0.05)
    flight = mapped(rock, clearance=0.5)
    assert len(flight.candidates)
    assert np.linalg.norm(flight.candidates, axis=1).min() > 5.0


def test_flights_stay_under_the_ceiling_and_over_the_ground_also_where_nothing_stands() -> None:
    flight = mapped(icosphere(1).translated((0.0, 0.0, 3.5)))
    heights = flight.space.points[flight.corridor][:, 2]
    assert RADIUS <= heights.min() <= 1.0  # the map's points are 0.5 m apart in height
    assert CEILING - 0.5 <= heights.max() <= CEILING


def test_map_bounds_the_clearance_from_below(world: World) -> None:
    valley: Place = world.places[0]
    mesh = Mesh.merge([*valley.ground.tiles(), *(o.mesh for o in valley.obstacles)])
    corners = np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0)
    space = free_space(valley.config, valley.scene).space
    near = np.argwhere((space.clearance > 0) & (space.clearance < 0.55))
    for i, j, k in np.random.default_rng(0).permutation(near)[:25]:
        exact = point_triangle_distance(space.points[i, j, k], *corners)
        assert space.clearance[i, j, k] <= exact + 1e-5 <= space.clearance[i, j, k] + 0.1


def space_of(clearance: list[object], x: float = 1.0, y: float = 1.0, z: float = 1.0) -> FreeSpace:
    values = np.array(clearance, dtype=float)
    return FreeSpace(*(step * np.arange(n) for step, n in zip((x, y, z), values.shape, strict=True)), values)


def part(space: FreeSpace, radius: float, allowed: np.ndarray | None = None) -> list[object]:
    return space.largest_part(np.ones(space.clearance.shape, bool) if allowed is None else allowed, radius).tolist()


@pytest.mark.parametrize(
    ("clearance", "expected"),
    [
        ([1.0, 1.0, 1.0, 0.9], [1, 1, 1, 0]),
        ([0.5, 1.5, 0.6, 1.2], [1, 1, 1, 0]),
        ([1.0, 1.0, 0.4, 1.0], [1, 1, 0, 0]),
        ([0.4, 0.4], [0, 0]),
        ([1.0], [1]),
        ([[1, 1, 0], [0, 0, 1], [0, 0, 1], [0, 0, 1]], [[0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 1]]),
    ],
)
def test_a_ball_passes_between_neighbours_with_room_for_it_halfway(clearance: list, expected: list) -> None:
    """With clearances c1 and c2 at h apart, it has (c1 + c2 - h) / 2 at least: here h = 1 and the ball's radius 0.5.

    It passes no corners, and of two sides the larger is taken.
    """
    given, wanted = np.array(clearance, float), np.array(expected, bool)
    for shape in ((*given.shape, 1, 1)[:3], (1, 1, *given.shape)[-3:]):
        assert part(space_of(given.reshape(shape).tolist()), 0.5) == wanted.reshape(shape).tolist()


def test_the_step_along_each_axis_counts() -> None:
    clearance = [[[0.8, 0.8], [0.8, 0.8]], [[0.8, 0.8], [0.8, 0.8]]]
    assert np.sum(part(space_of(clearance), 0.3)) == 8
    assert part(space_of(clearance, z=2.0), 0.3) == [[[True, False]] * 2] * 2  # two layers; the first counts
    assert np.sum(part(space_of(clearance, x=2.0, y=2.0, z=2.0), 0.3)) == 1


def test_a_way_in_the_third_dimension_joins() -> None:
    """Two halves of a layer that a wall parts are joined over its top."""
    clear, allowed = np.ones((3, 1, 2)), np.ones((3, 1, 2), dtype=bool)
    clear[1, 0, 0] = 0.0
    assert np.sum(part(space_of(clear.tolist()), 0.5)) == 5
    allowed[1, 0, 1] = False
    assert np.sum(part(space_of(clear.tolist()), 0.5, allowed)) == 2
    assert not np.any(part(space_of(clear.tolist()), 0.5, allowed & False))


def test_surface_points_leave_no_gap() -> None:
    rng = np.random.default_rng(0)
    mesh = Mesh(rng.uniform(-1, 1, (30, 3)), np.arange(30).reshape(-1, 3))
    weights = rng.dirichlet([1, 1, 1], 2000)
    samples = (weights @ mesh.vertices[mesh.faces]).reshape(-1, 3)
    assert cKDTree(surface_points(mesh, -2, 2)).query(samples)[0].max() <= 0.1 / 3**0.5
