"""Planes: at a constant speed along their lanes, from wall to wall, whatever the time is cut into."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest

from tests.helpers.geometry import assert_closed
from uavrl.envs.lanes import Lane
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.traffic import Leg, Traffic, plane_mesh
from uavrl.envs.world import World, WorldConfig

SIZE = np.array([40.0, 30.0])
DT = 0.1  # s


@pytest.fixture(scope="module")
def world() -> World:
    return World(WorldConfig(seeds=(0, 1), planes=3, obstacles=5))


def straight_leg(speed: float, backwards: bool = False, speeds: tuple[float, float] | None = None) -> Leg:
    """A leg at the start of 10 m along x at 3 m height."""
    lane = Lane(np.array([[0.0, 0.0, 3.0], [10.0, 0.0, 3.0]]))
    leg = Leg(np.random.default_rng(0), [lane], speeds or (speed, speed))
    leg.flown, leg.backwards, leg.speed = 0.0, backwards, speed
    return leg


def test_a_leg_is_flown_at_its_speed_either_way() -> None:
    there, back = (straight_leg(4.0, backwards).fly(5, 0.5) for backwards in (False, True))
    np.testing.assert_allclose(there[:, :3], [[x, 0.0, 3.0] for x in (2.0, 4.0, 6.0, 8.0, 10.0)])
    np.testing.assert_allclose(back[:, :3], [[x, 0.0, 3.0] for x in (8.0, 6.0, 4.0, 2.0, 0.0)], atol=1e-9)
    np.testing.assert_allclose(there[:, 3], 0.0)
    np.testing.assert_allclose(np.cos(back[:, 3]), -1.0)


def test_the_next_leg_begins_when_one_ends() -> None:
    """10 m at 4 m/s last 2.5 s: of 3 s, half a second belongs to the next one, which leads either way."""
    leg = straight_leg(4.0)
    last = leg.fly(1, 3.0)[0]
    assert leg.flown == pytest.approx(2.0)
    assert last[0] == pytest.approx(8.0 if leg.backwards else 2.0)
    ways = set()
    for seed in range(20):
        leg = straight_leg(4.0)
        leg._rng = np.random.default_rng(seed)
        leg.fly(1, 3.0)
        ways.add(leg.backwards)
    assert ways == {False, True}


def test_speeds_are_drawn_per_leg_within_their_limits() -> None:
    leg, speeds = straight_leg(3.5, speeds=(3.0, 4.0)), []
    for _ in range(100):
        leg.fly(1, leg.lane.length / 3.0 + 0.1)
        speeds.append(leg.speed)
    assert 3.0 <= min(speeds) < 3.1 and 3.9 < max(speeds) <= 4.0


def test_planes_stay_in_their_valley(world):
    traffic = Traffic(world, np.random.default_rng(0))
    path = traffic.advance(3000, DT)
    assert path.shape == (3000, 6, 4)
    assert traffic.places.tolist() == [0, 0, 0, 1, 1, 1]
    origins = np.array([world.places[v].origin for v in traffic.places])
    assert (np.abs(path[..., :2] - origins) <= SIZE / 2 + 1e-9).all()
    assert path[..., 2].min() > 0.5 and 8.0 < path[..., 2].max() < 12.0


def test_planes_fly_at_a_constant_speed_within_the_limits_and_look_ahead(world):
    traffic = Traffic(world, np.random.default_rng(0))
    poses, speeds = [], []
    for _ in range(1200):
        poses.append(traffic.advance(1, DT)[0])
        speeds.append([leg.speed for leg in traffic.legs])
    path, speed = np.array(poses), np.array(speeds)
    same = speed[1:] == speed[:-1]  # no new leg began
    assert 0.98 < same.mean() < 1.0
    assert speed.min() >= 3.0 and speed.max() <= 4.0 and np.ptp(speed) > 0.8
    moved = np.diff(path[..., :3], axis=0)
    share = (np.linalg.norm(moved, axis=-1) / DT / speed[1:])[same]
    assert share.max() <= 1.0 + 1e-6
    assert np.mean(share > 1 - 1e-6) > 0.94  # but where a dive begins or ends between two steps
    turned = np.diff(path[..., 3], axis=0)[same]
    np.testing.assert_allclose(turned, 0.0, atol=1e-12)
    ahead = np.stack([np.cos(path[:-1, :, 3]), np.sin(path[:-1, :, 3])], -1)
    level = np.linalg.norm(moved[..., :2], axis=-1)
    seen = (moved[..., :2] * ahead).sum(-1) > np.cos(0.3) * level
    assert seen[same].all()


def test_the_time_can_be_cut_into_any_calls(world):
    whole = Traffic(world, np.random.default_rng(0)).advance(720, DT)
    assert not np.allclose(Traffic(world, np.random.default_rng(1)).advance(720, DT), whole)
    traffic, pieces = Traffic(world, np.random.default_rng(0)), []
    for steps in (24,) * 20 + (1,) * 20 + (220,):
        pieces.append(traffic.advance(steps, DT))
        np.testing.assert_allclose(traffic.poses(), pieces[-1][-1], atol=1e-6)
        assert (np.abs(traffic.poses()[:, 3]) <= np.pi).all()
    np.testing.assert_allclose(np.concatenate(pieces), whole, atol=1e-6)


def test_planes_begin_spread_over_their_lanes():
    lane = Lane(np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]))
    starts = [Leg(np.random.default_rng(seed), [lane], (3.0, 4.0)).flown for seed in range(200)]
    assert 0 <= min(starts) < 0.5 and 9.5 < max(starts) <= 10.0
    assert 4.0 < np.mean(starts) < 6.0


def test_static_world_has_no_traffic():
    traffic = Traffic(World(WorldConfig(obstacles=5)), np.random.default_rng(0))
    assert traffic.positions.shape == (0, 3) and traffic.poses().shape == (0, 4)
    assert traffic.advance(24, 0.1).shape == (24, 0, 4)


def test_plane_model():
    mesh = plane_mesh(2.0)
    assert_closed(mesh)
    assert 50 <= len(mesh.faces) <= 300
    assert np.ptp(mesh.vertices[:, 1]) == pytest.approx(2.0)
    assert np.ptp(mesh.vertices, axis=0).argmax() == 1
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    assert high[0] > 0 > low[0] and high[2] > -low[2]  # the fin points up
    np.testing.assert_allclose(plane_mesh(3.0).vertices, mesh.vertices * 1.5, rtol=1e-6)


def test_an_environment_tells_the_ways_that_its_planes_will_fly():
    env = NavigationEnv(1, world=WorldConfig(planes=2, obstacles=5))
    env.reset()
    told = env.plane_paths(30)
    again = env.plane_paths(30)
    flown = []
    for _ in range(30):
        env.step(env.rand_action(env.reset()))  # a collision ends no plane's flight
        flown.append(env.plane_poses())
    env.close()
    np.testing.assert_array_equal(told, again)
    np.testing.assert_allclose(told, flown, atol=1e-9)


def test_all_planes_at_once_fly_where_each_leg_would(world):
    traffic = Traffic(world, np.random.default_rng(0))
    legs, entered = deepcopy(traffic.legs), 0
    for steps in (24, 1, 3) * 40:
        before = [leg.speed for leg in legs]
        alone = np.stack([leg.fly(steps, DT) for leg in legs], axis=1)
        entered += sum(leg.speed != speed for leg, speed in zip(legs, before, strict=True))
        alone[..., :2] += np.array([world.places[valley].origin for valley in traffic.places])
        together = traffic.advance(steps, DT)
        np.testing.assert_allclose(together[..., :3], alone[..., :3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * together[..., 3]), np.exp(1j * alone[..., 3]), rtol=0, atol=1e-9)
    assert entered > 20
