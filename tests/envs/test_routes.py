"""Routes of planes: clear of all geometry, in over the walls and out again, at all heights that UAVs use."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from pybullet_utils.bullet_client import BulletClient

from tests.helpers.geometry import bullet_world, convex_body, embree, pierced
from uavrl.envs.mesh import Mesh, icosphere, loft, turned
from uavrl.envs.routes import STEP, plan_routes, smoothed
from uavrl.envs.terrain import HeightField
from uavrl.envs.traffic import plane_mesh
from uavrl.envs.world import Valley, World, WorldConfig
from uavrl.errors import UavrlError

CONFIG = WorldConfig(planes=3)
PLANE = plane_mesh(CONFIG.plane_wingspan)
HALF = np.array([20.0, 15.0])  # m, from the middle of the valley to its border


@pytest.fixture(scope="module")
def valley() -> Valley:
    return World(CONFIG).valleys[0]


@pytest.fixture(scope="module")
def physics(valley: Valley) -> Iterator[tuple[BulletClient, list[int]]]:
    client, bodies = bullet_world(valley.meshes())
    yield client, bodies
    client.disconnect()


def test_routes_keep_a_flat_ellipsoid_clear_and_planes_hardly_touch_anything(
    valley: Valley, physics: tuple[BulletClient, list[int]]
) -> None:
    """The ellipsoid, as wide as a plane and half as high, never does; the tips of the wings reach out of it a little.

    Bullet asks with convex hulls; where that of the plane touches, Embree asks with the plane itself.
    """
    client, bodies = physics
    solid = Mesh.merge(valley.meshes())
    scene, radius = embree([solid]), CONFIG.plane_wingspan / 2
    ellipsoid = convex_body(client, Mesh(icosphere(2).vertices * radius * [0.99, 0.99, 0.495], icosphere(2).faces))
    hull = convex_body(client, PLANE)
    poses, touching = np.concatenate([route[::2] for route in valley.routes]), 0
    for x, y, z, yaw in poses:
        for body in (ellipsoid, hull):
            client.resetBasePositionAndOrientation(body, (x, y, z), (0, 0, np.sin(yaw / 2), np.cos(yaw / 2)))
        assert not any(client.getClosestPoints(ellipsoid, body, 0.0) for body in bodies), (x, y, z)
        if any(client.getClosestPoints(hull, body, 0.0) for body in bodies):
            touching += pierced(turned(PLANE, yaw).translated((x, y, z)), solid, scene)
    assert touching <= 0.005 * len(poses)
    spire = next(obstacle for obstacle in valley.obstacles if obstacle.kind == "spire")
    for place in (np.add(spire.position, (0.3, 0.0, 4.0)), np.array([*HALF * 0.95, 3.0])):
        client.resetBasePositionAndOrientation(hull, place, (0, 0, 0, 1))
        assert any(client.getClosestPoints(hull, body, 0.0) for body in bodies), "what would touch is found"
        assert pierced(PLANE.translated(place), solid, scene)


def test_routes_come_in_over_a_wall_and_leave_over_another(valley: Valley) -> None:
    assert len(valley.routes) >= 8
    wall = valley.ground.heights.max()
    pairs = set()
    for route in valley.routes:
        to_edges = np.concatenate([route[[0, -1], :2] + HALF, HALF - route[[0, -1], :2]], axis=1)  # [2, 4]
        assert (to_edges.min(1) < 1.0).all()
        assert (to_edges.min(1) >= 0).all()
        assert len(set(to_edges.argmin(1).tolist())) == 2
        assert (route[[0, -1], 2] > wall + 0.75).all()
        pairs |= set(to_edges.argmin(1).tolist())
    assert pairs == {0, 1, 2, 3}


def test_routes_are_where_uavs_fly_and_spread_over_the_heights(valley: Valley) -> None:
    heights = [route[:, 2] - valley.ground.at(route[:, :2]) for route in valley.routes]
    assert min((height < CONFIG.ceiling).mean() for height in heights) > 0.4
    flown = np.concatenate(heights)
    flown = flown[flown < CONFIG.ceiling]
    shares = np.histogram(flown, bins=[0.0, 1.25, 2.5, 3.75, 5.0])[0] / len(flown)
    assert shares[1:].min() > 0.15 and shares[0] < 0.2  # a wing span needs room over the ground
    levels = [np.median(height[height < CONFIG.ceiling]) for height in heights]
    assert np.ptp(levels) > 2.0


def test_routes_cross_the_whole_valley(valley: Valley) -> None:
    places = np.concatenate([route[route[:, 2] < CONFIG.ceiling, :2] for route in valley.routes])
    cells = np.unique(np.floor(places / 5.0).astype(int), axis=0)
    assert len(cells) > 0.6 * 8 * 6  # of 5 m by 5 m


def test_points_of_a_route_are_a_step_apart_and_look_along_it(valley: Valley) -> None:
    for route in valley.routes:
        apart = np.linalg.norm(np.diff(route[:, :3], axis=0), axis=1)
        assert apart.max() <= STEP + 1e-9
        assert np.median(apart) > 0.98 * STEP
        move = np.diff(route[:, :2], axis=0)
        ahead = np.stack([np.cos(route[:-1, 3]), np.sin(route[:-1, 3])], -1)
        along = (move * ahead).sum(1) / np.linalg.norm(move, axis=1)
        assert np.mean(along > np.cos(0.2)) > 0.95
        assert np.mean(np.abs(np.diff(route[:, 2])) <= 0.75 * STEP) > 0.8  # 45° up or down, but where it turns back


def test_a_straight_line_stays_straight_and_a_bend_is_rounded() -> None:
    line = smoothed(np.array([[0.0, 0.0, 2.0], [10.0, 0.0, 2.0]]))
    np.testing.assert_allclose(line[:, 1:], np.tile([0.0, 2.0, 0.0], (len(line), 1)), atol=1e-9)
    corner = np.array([[0.0, 0.0, 2.0], [10.0, 0.0, 2.0], [10.0, 10.0, 2.0]])
    bend = smoothed(corner)
    np.testing.assert_allclose(bend[[0, -1], :3], corner[[0, -1]], atol=0.5)
    np.testing.assert_allclose(bend[[5, -5], 3], [0.0, np.pi / 2], atol=0.02)
    assert 0.2 < np.linalg.norm(bend[:, :2] - [10.0, 0.0], axis=1).min() < 1.0
    assert np.abs(np.diff(bend[:, 3])).max() < 0.35


def test_the_same_seed_plans_the_same_routes_and_a_closed_valley_is_refused() -> None:
    flat = HeightField(np.zeros((2, 2)), (12.0, 12.0))
    first, same, other = (
        plan_routes(np.random.default_rng(seed), Mesh.merge(flat.tiles()), flat.size, 6.0, 5.0, 1.0, 2)
        for seed in (5, 5, 6)
    )
    assert len(first) == 2 and all(map(np.array_equal, first, same))
    assert not np.array_equal(first[0][:5], other[0][:5])
    lid = loft(np.stack([np.array([[-9.0, -9, z], [9, -9, z], [9, 9, z], [-9, 9, z]]) for z in (4.0, 6.0)]))
    closed = Mesh.merge([*flat.tiles(), lid])
    with pytest.raises(UavrlError, match="lower plane_wingspan"):
        plan_routes(np.random.default_rng(0), closed, (12.0, 12.0), 9.0, 5.0, 1.5, 2)
