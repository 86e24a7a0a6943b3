"""Obstacles: closed and cheap, rooted in the ground, and as dense at every height and in every part of the valley."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.helpers.geometry import assert_closed, point_triangle_distance
from uavrl.envs.mesh import icosphere
from uavrl.envs.obstacles import KINDS, make_obstacle, wall_places
from uavrl.envs.place import Place
from uavrl.envs.tasks import surface_points
from uavrl.envs.world import World, WorldConfig
from uavrl_onboard.mesh import Mesh, loft, signed_volume

HALF = np.array([20.0, 15.0])  # m, from the middle of a valley to its border
CEILING = 5.0  # m above ground
HEIGHTS = np.arange(1.0, 4.6, 0.5)  # m above ground
SEEDS = (0, 1, 2, 100)


@pytest.fixture(scope="module")
def valleys() -> list[Place]:
    return World(WorldConfig(seeds=SEEDS)).places


@pytest.fixture(scope="module")
def surfaces(valleys: list[Place]) -> list[cKDTree]:
    """Points of the geometry of each valley, no place of which is farther than 6 cm from one."""
    meshes = [Mesh.merge([*valley.ground.tiles(), *(o.mesh for o in valley.obstacles)]) for valley in valleys]
    return [cKDTree(surface_points(mesh, -0.5, 6.0), balanced_tree=False, compact_nodes=False) for mesh in meshes]


def near(valley: Place, surface: cKDTree, xy: np.ndarray, distance: float) -> np.ndarray:
    """Which places ``[P, H]`` at ``xy [P, 2]`` and ``HEIGHTS`` above the ground are within a distance of geometry."""
    z = valley.ground.at(xy)[:, None] + HEIGHTS
    points = np.concatenate([np.broadcast_to(xy[:, None], (*z.shape, 2)), z[..., None]], -1)
    return np.isfinite(surface.query(points, distance_upper_bound=distance)[0])


@pytest.mark.parametrize("kind", KINDS)
def test_obstacles_are_closed_and_cheap(kind: str) -> None:
    for seed in range(12):
        mesh = make_obstacle(np.random.default_rng(seed), kind)
        assert_closed(mesh)
        assert len(mesh.faces) < 1000
        assert mesh.vertices[:, 2].min() < -0.5


def test_shapes_turn_outwards_whichever_way_the_rings_turn() -> None:
    square = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    upper = square + np.array([0, 0, 2])
    for rings in (np.stack([square, upper]), np.stack([upper, square])):
        assert_closed(loft(rings))
        assert signed_volume(loft(rings)) == pytest.approx(4.0)
    assert signed_volume(icosphere(3)) == pytest.approx(4 / 3 * np.pi, rel=0.02)


@pytest.mark.parametrize("kind", ["tree", "spire", "pole", "buttress"])
def test_tall_kinds_cannot_be_flown_over(kind: str) -> None:
    for seed in range(20):
        assert make_obstacle(np.random.default_rng(seed), kind).vertices[:, 2].max() > 6.0 > CEILING


@pytest.mark.parametrize(("kind", "low", "high"), [("boulder", 1.0, 3.2), ("mushroom", 4.0, 6.5), ("bridge", 1.0, 6.0)])
def test_low_and_hanging_kinds_leave_the_rest_of_the_height_to_others(kind: str, low: float, high: float) -> None:
    tops = [make_obstacle(np.random.default_rng(seed), kind).vertices[:, 2].max() for seed in range(20)]
    assert low < min(tops) and max(tops) < high
    assert np.std(tops) > 0.2


def test_one_can_fly_under_mushrooms_and_bridges_and_through_arches() -> None:
    """Beside the stem of a mushroom, and in the middle of the others, at half their height."""
    for kind, offset in (("mushroom", 0.75), ("arch", 0.0)):
        for seed in range(20):
            mesh = KINDS[kind](np.random.default_rng(seed))
            corners = np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0)
            assert point_triangle_distance(np.array([offset, 0.0, 1.4]), *corners) > 0.25
    bridges = [KINDS["bridge"](np.random.default_rng(seed)).vertices for seed in range(20)]
    free = np.array([bridge[np.abs(bridge[:, 0]) < 1.1, 2].min() for bridge in bridges])  # m under the middle
    assert np.mean(free > 0.7) >= 0.75


def test_number_and_scale_are_keys_and_valleys_take_their_numbers_in_turn() -> None:
    mixed = World(WorldConfig(seeds=(0, 1, 2), obstacles=(4, 7)))
    assert [len(valley.obstacles) for valley in mixed.places] == [4, 7, 4]
    alone, large = (
        World(WorldConfig(seeds=(1,), obstacles=7, obstacle_scale=s)).places[0].obstacles for s in (1.0, 1.5)
    )
    assert [o.position for o in mixed.places[1].obstacles] == [o.position for o in alone]
    assert sum(o.radius for o in large) == pytest.approx(1.5 * sum(o.radius for o in alone), rel=1e-4)
    assert World(WorldConfig(obstacles=0)).places[0].obstacles == []


def test_every_kind_stands_in_every_valley_in_different_sizes(valleys: list[Place]) -> None:
    for valley in valleys:
        kinds = [obstacle.kind for obstacle in valley.obstacles]
        assert len(kinds) == 45 and set(kinds) == set(KINDS)
        sizes = [obstacle.radius for obstacle in valley.obstacles if obstacle.kind == "spire"]
        assert np.std(sizes) > 0.01
        past_the_ceiling = [o.mesh.vertices[:, 2].max() > 5.5 for o in valley.obstacles]
        assert np.mean(past_the_ceiling) > 0.6


def test_nothing_floats(valleys: list[Place]) -> None:
    """The feet of an obstacle, all that is within 0.3 m of its lowest vertex, are below the ground at their place."""
    for valley in valleys:
        for obstacle in valley.obstacles:
            vertices = obstacle.mesh.vertices
            feet = vertices[vertices[:, 2] <= vertices[:, 2].min() + 0.3]
            assert (feet[:, 2] < valley.ground.at(feet[:, :2])).all(), obstacle.kind


def test_buttresses_stand_out_from_the_walls_and_stay_inside_the_border(valleys: list[Place]) -> None:
    for valley in valleys:
        for obstacle in valley.obstacles:
            if obstacle.kind == "buttress":
                xy = np.abs(obstacle.mesh.vertices[:, :2])
                to_border = (HALF - xy).min(1)
                assert to_border.min() > -1e-4
                assert to_border.min() < 0.5 and to_border.max() > 2.0


def test_directions_from_the_walls_lead_inwards() -> None:
    places, inwards = wall_places(np.random.default_rng(0), HALF, 400)
    ahead = places + 0.1 * np.stack([np.cos(inwards), np.sin(inwards)], -1)
    np.testing.assert_allclose((HALF - np.abs(places)).min(1), 0.0, atol=1e-9)
    assert ((HALF - np.abs(ahead)).min(1) > -1e-9).all()
    on_x = np.isclose(np.abs(places[:, 0]), 20.0)
    np.testing.assert_allclose((HALF - np.abs(ahead))[np.arange(400), np.where(on_x, 0, 1)], 0.1)
    assert on_x.mean() == pytest.approx(30 / 70, abs=0.08)


def test_obstacles_are_as_dense_at_every_height_and_in_every_part_of_the_valley(
    valleys: list[Place], surfaces: list[cKDTree]
) -> None:
    """The share of places within 0.6 m of geometry, 3 m and more from the border and beside the walls."""
    xy = np.random.default_rng(0).uniform(-1, 1, (1500, 2)) * HALF
    to_border = (HALF - np.abs(xy)).min(1)
    close = np.array([near(valley, surface, xy, 0.6) for valley, surface in zip(valleys, surfaces, strict=True)])
    by_height = close[:, to_border > 3.0].mean(1)
    assert ((by_height.mean(1) > 0.13) & (by_height.mean(1) < 0.25)).all()
    relative = by_height / by_height.mean(1, keepdims=True)
    assert relative.min() > 0.75 and relative.max() < 1.25
    bands = [(to_border >= low) & (to_border < high) for low, high in ((3, 5), (5, 7), (7, 9), (9, 12), (12, 15))]
    by_band = np.array([close[:, band].mean() for band in bands])
    relative = by_band / by_band.mean()
    assert relative.min() > 0.75 and relative.max() < 1.25
    beside = (to_border >= 1.0) & (to_border < 3.0)
    assert (close[:, beside].mean((1, 2)) > 1.3 * by_height.mean(1)).all()


def test_no_lane_leads_along_a_wall(valleys: list[Place], surfaces: list[cKDTree]) -> None:
    """Of straight flights over 10 m in parallel to a wall, fewer pass near it than in the middle of the valley."""
    for valley, surface in zip(valleys, surfaces, strict=True):
        beside, inside = (
            np.mean([pass_share(valley, surface, offset) for offset in offsets])
            for offsets in ((1.7, 2.2, 2.7, 3.2, 3.7, 4.2), (6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0))
        )
        assert beside < 0.25 and beside < 0.9 * inside


def pass_share(valley: Place, surface: cKDTree, offset: float) -> float:
    """Share of the 10 m long pieces of the lines at ``offset`` m from the border that keep 0.4 m to geometry."""
    passed = []
    for axis, side in ((0, -1), (0, 1), (1, -1), (1, 1)):
        free_axis = np.arange(2.0 - HALF[axis], HALF[axis] - 2.0, 0.25)
        xy = np.full((len(free_axis), 2), side * (HALF[1 - axis] - offset))
        xy[:, axis] = free_axis
        close = near(valley, surface, xy, 0.4)
        passed.append(np.lib.stride_tricks.sliding_window_view(~close, 40, axis=0).all(-1).ravel())
    return float(np.concatenate(passed).mean())
