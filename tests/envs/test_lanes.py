"""Lanes of planes: straight, clear of all geometry, in over the walls and out again, at all heights that UAVs use."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from pybullet_utils.bullet_client import BulletClient

from tests.helpers.geometry import bullet_world, convex_body, embree, pierced
from uavrl.envs.lanes import BELOW_CEILING, LOWEST, Airspace, Lane, plan_lanes
from uavrl.envs.mesh import icosphere, turned
from uavrl.envs.place import Place
from uavrl.envs.terrain import HeightField
from uavrl.envs.traffic import plane_mesh
from uavrl.envs.world import World, WorldConfig
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh, loft

CONFIG = WorldConfig(planes=3)
PLANE = plane_mesh(CONFIG.plane_wingspan)
HALF = np.array([20.0, 15.0])  # m, from the middle of the valley to its border


@pytest.fixture(scope="module")
def valley() -> Place:
    return World(CONFIG).places[0]


@pytest.fixture(scope="module")
def physics(valley: Place) -> Iterator[tuple[BulletClient, list[int]]]:
    client, bodies = bullet_world(valley.meshes())
    yield client, bodies
    client.disconnect()


def places(lane: Lane, step: float = 0.5) -> np.ndarray:
    return lane.poses(np.arange(0.0, lane.length, step))


def wall(x: float, low: float, high: float) -> Mesh:
    """A wall across a valley, 1 m thick, from x, between two heights."""
    return loft(np.stack([np.array([[x, -9.0, z], [x + 1, -9, z], [x + 1, 9, z], [x, 9, z]]) for z in (low, high)]))


def test_a_lane_dives_flies_level_and_climbs_at_one_speed() -> None:
    """Down 3 m and 4 m ahead make 5 m; the yaw is that of the way, whichever end it begins at."""
    lane = Lane(np.array([[0.0, 0.0, 5.0], [0.0, 4.0, 2.0], [0.0, 10.0, 2.0], [0.0, 14.0, 5.0]]))
    assert lane.length == 16.0
    there = lane.poses(np.array([0.0, 2.5, 5.0, 8.0, 16.0]))
    want = [[0, 0, 5], [0, 2, 3.5], [0, 4, 2], [0, 7, 2], [0, 14, 5]]
    np.testing.assert_allclose(there, np.column_stack([want, np.full(5, np.pi / 2)]), atol=1e-12)
    back = lane.poses(np.array([0.0, 5.0, 6.0]), backwards=True)
    np.testing.assert_allclose(back[:, :3], [[0, 14, 5], [0, 10, 2], [0, 9, 2]], atol=1e-12)
    np.testing.assert_allclose(back[:, 3], -np.pi / 2)


def test_lanes_keep_a_flat_ellipsoid_clear_and_planes_hardly_touch_anything(
    valley: Place, physics: tuple[BulletClient, list[int]]
) -> None:
    """The ellipsoid, as wide as a plane and half as high, never does; the tips of the wings reach out of it a little.

    Bullet asks with convex hulls; where that of the plane touches, Embree asks with the plane itself.
    """
    client, bodies = physics
    solid = Mesh.merge(valley.meshes())
    scene, radius = embree([solid]), CONFIG.plane_wingspan / 2
    ellipsoid = convex_body(client, Mesh(icosphere(2).vertices * radius * [0.99, 0.99, 0.495], icosphere(2).faces))
    hull = convex_body(client, PLANE)
    poses, touching = np.concatenate([places(lane) for lane in valley.lanes]), 0
    for x, y, z, yaw in poses:
        for body in (ellipsoid, hull):
            client.resetBasePositionAndOrientation(body, (x, y, z), (0, 0, np.sin(yaw / 2), np.cos(yaw / 2)))
        assert not any(client.getClosestPoints(ellipsoid, body, 0.0) for body in bodies), (x, y, z)
        if any(client.getClosestPoints(hull, body, 0.0) for body in bodies):
            touching += pierced(turned(PLANE, yaw).translated((x, y, z)), solid, scene)
    assert touching <= 0.005 * len(poses)
    spire = next(obstacle for obstacle in valley.obstacles if obstacle.kind == "spire")
    corner = HALF * 0.95
    for place in (spire.mesh.vertices[0], np.array([*corner, *valley.ground.at(corner[None])])):
        client.resetBasePositionAndOrientation(hull, place, (0, 0, 0, 1))
        assert any(client.getClosestPoints(hull, body, 0.0) for body in bodies), "what would touch is found"
        assert pierced(PLANE.translated(place), solid, scene)


def test_lanes_come_in_over_a_wall_and_leave_over_another(valley: Place) -> None:
    assert len(valley.lanes) >= 8
    wall = valley.ground.heights.max()
    pairs = set()
    for lane in valley.lanes:
        route = lane.corners
        to_edges = np.concatenate([route[[0, -1], :2] + HALF, HALF - route[[0, -1], :2]], axis=1)  # [2, 4]
        assert (to_edges.min(1) < 1.0).all()
        assert (to_edges.min(1) >= 0).all()
        assert len(set(to_edges.argmin(1).tolist())) == 2
        assert (route[[0, -1], 2] > wall + CONFIG.plane_wingspan / 4).all()  # half as high as wide
        pairs |= set(to_edges.argmin(1).tolist())
    assert pairs == {0, 1, 2, 3}


def test_lanes_are_straight_and_level_for_18_m_where_uavs_fly(valley: Place) -> None:
    for lane in valley.lanes:
        x, y, z, yaw = lane.poses(np.linspace(0.0, lane.length, 400)).T
        off = (x - x[0]) * np.sin(yaw) - (y - y[0]) * np.cos(yaw)
        np.testing.assert_allclose(off, 0.0, atol=1e-9)
        level = np.isclose(z, lane.corners[2, 2])
        assert LOWEST <= lane.corners[2, 2] <= CONFIG.ceiling - BELOW_CEILING
        assert np.hypot(np.ptp(x[level]), np.ptp(y[level])) >= 17.8
        ahead, up = np.linalg.norm(np.diff(lane.corners[:, :2], axis=0), axis=1), np.diff(lane.corners[:, 2])
        np.testing.assert_allclose(up, ahead * [0, -1, 0, 1, 0], atol=1e-9)
    levels = sorted(lane.corners[2, 2] for lane in valley.lanes)
    assert levels[0] < 2.2 and levels[-1] > 4.0 and max(np.diff(levels)) < 0.8


def test_lanes_cross_the_whole_valley(valley: Place) -> None:
    route = np.concatenate([places(lane) for lane in valley.lanes])
    cells = np.unique(np.floor(route[route[:, 2] < CONFIG.ceiling, :2] / 5.0).astype(int), axis=0)
    assert len(cells) > 0.5 * 8 * 6  # of 5 m by 5 m


def test_a_lane_keeps_out_of_a_wall_with_a_gap() -> None:
    """Walls across the way leave the heights from 2.5 to 4.5 m: the level lies between, a flat ellipsoid from both."""
    flat = HeightField(np.zeros((2, 2)), (40.0, 12.0))
    solid = Mesh.merge([*flat.tiles(), wall(-0.5, 0.0, 2.5), wall(-0.5, 4.5, 6.0)])
    lanes = plan_lanes(np.random.default_rng(0), solid, flat.size, 8.0, 5.0, 0.6, 12)
    crossing = [lane for lane in lanes if np.sign(lane.corners[2:4, 0]).prod() < 0]
    assert crossing
    for lane in crossing:
        assert 2.8 <= lane.corners[2, 2] <= 4.2  # half of 0.6 m from either


def test_what_is_free_is_measured_along_the_whole_lane() -> None:
    airspace = Airspace(Mesh.merge([wall(3.0, 0.0, 3.0)]), (40.0, 12.0), 8.0, 0.6)

    def at(z: float, first: float, last: float) -> bool:
        return airspace.is_free(Lane(np.array([[first, 0.0, z], [last, 0.0, z]])))

    assert at(3.4, -10.0, 10.0) and not at(3.2, -10.0, 10.0) and at(3.2, -10.0, 2.3) and not at(3.2, -10.0, 2.5)


def test_the_same_seed_plans_the_same_lanes_and_a_closed_valley_is_refused() -> None:
    flat = HeightField(np.zeros((2, 2)), (30.0, 30.0))
    first, same, other = (
        plan_lanes(np.random.default_rng(seed), Mesh.merge(flat.tiles()), flat.size, 6.0, 5.0, 0.6, 2)
        for seed in (5, 5, 6)
    )
    corners = [[lane.corners for lane in lanes] for lanes in (first, same, other)]
    assert len(first) == 2 and all(map(np.array_equal, corners[0], corners[1]))
    assert not np.array_equal(corners[0][0], corners[2][0])
    lid = loft(np.stack([np.array([[-16.0, -16, z], [16, -16, z], [16, 16, z], [-16, 16, z]]) for z in (5.5, 6.0)]))
    with pytest.raises(UavrlError, match=r"a straight way of 13\.5 m .* lower plane_wingspan"):
        plan_lanes(np.random.default_rng(0), Mesh.merge([*flat.tiles(), lid]), flat.size, 9.0, 5.0, 0.6, 2)


def test_where_the_ceiling_is_above_all_walls_lanes_above_these_are_level_throughout() -> None:
    flat = HeightField(np.zeros((2, 2)), (30.0, 30.0))
    lanes = plan_lanes(np.random.default_rng(0), Mesh.merge(flat.tiles()), flat.size, 6.0, 20.0, 0.6, 4)
    levels = sorted(lane.corners[2, 2] for lane in lanes)
    np.testing.assert_allclose(levels, np.linspace(LOWEST, 20.0 - BELOW_CEILING, 4))
    for lane in lanes:
        low, high = lane.corners[:, 2].min(), lane.corners[:, 2].max()
        assert (high - low > 4.0) if low < 6.0 else (high == low)
