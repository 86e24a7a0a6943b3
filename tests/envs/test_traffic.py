from __future__ import annotations

import numpy as np
import pytest

from tests.envs.test_world import assert_closed
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.traffic import Leg, Traffic, plane_mesh
from uavrl.envs.world import World, WorldConfig

SIZE = np.array([40.0, 30.0])


@pytest.fixture(scope="module")
def world() -> World:
    return World(WorldConfig(seeds=(0, 1), planes=3, obstacles=5))


def fly(world, seed=0, steps=6000, dt=0.1):
    return Traffic(world, np.random.default_rng(seed)).advance(steps, dt)


def legs(path, dt=0.1):
    """Splits one plane's path [T, 4] where it re-enters."""
    moved = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)
    turned = np.abs(np.diff(path[:, 3])) > 1e-9
    return np.split(path, np.flatnonzero(turned | (moved > 4.0 * dt + 1e-6)) + 1)


def test_same_generator_same_traffic(world):
    np.testing.assert_array_equal(fly(world), fly(world))
    assert not np.allclose(fly(world), fly(world, seed=1))


def test_planes_stay_at_flight_level_in_their_valley(world):
    traffic = Traffic(world, np.random.default_rng(0))
    path = traffic.advance(6000, 0.1)
    assert path.shape == (6000, 6, 4)
    assert (path[..., 2] == 3.5).all()
    assert traffic.valleys.tolist() == [0, 0, 0, 1, 1, 1]
    origins = np.array([world.valleys[v].origin for v in traffic.valleys])
    assert (np.abs(path[..., :2] - origins) <= SIZE / 2 + 1e-9).all()


def test_legs_are_straight_and_of_constant_speed_in_range(world):
    path = fly(world)
    speeds = []
    for plane in range(6):
        whole = legs(path[:, plane])[1:-1]
        assert len(whole) > 20
        for leg in whole:
            moved = np.diff(leg[:, :2], axis=0)
            speed = np.linalg.norm(moved, axis=1) / 0.1
            np.testing.assert_allclose(speed, speed[0], rtol=1e-6)
            heading = np.array([np.cos(leg[0, 3]), np.sin(leg[0, 3])])
            np.testing.assert_allclose(moved, speed[0] * 0.1 * np.tile(heading, (len(moved), 1)), atol=1e-9)
            speeds.append(speed[0])
    assert min(speeds) >= 2.5 - 1e-6 and max(speeds) <= 4.0 + 1e-6
    assert np.ptp(speeds) > 1.0


def test_legs_lead_from_a_random_edge_to_another(world):
    path = fly(world)
    entered = set()
    for leg in legs(path[:, 0])[1:-1]:
        ends = []
        for xy in (leg[0, :2], leg[-1, :2]):
            to_edges = np.array([xy[0] + 20, 20 - xy[0], xy[1] + 15, 15 - xy[1]])
            assert to_edges.min() <= 0.4 + 1e-6  # one step at the highest speed
            ends.append(set(np.flatnonzero(to_edges <= 0.4 + 1e-6).tolist()))
        assert len(ends[0] | ends[1]) > 1
        entered |= ends[0]
    assert entered == {0, 1, 2, 3}


def test_the_time_can_be_cut_into_any_calls(world):
    whole = fly(world, steps=720)
    traffic = Traffic(world, np.random.default_rng(0))
    pieces = np.concatenate([traffic.advance(24, 0.1) for _ in range(30)])
    np.testing.assert_allclose(pieces, whole, atol=1e-6)


def test_positions_and_yaws_are_the_last_of_the_path(world):
    traffic = Traffic(world, np.random.default_rng(0))
    for _ in range(50):
        last = traffic.advance(24, 0.05)[-1]
        np.testing.assert_allclose(traffic.positions, last[:, :3], atol=1e-9)
        np.testing.assert_array_equal(traffic.yaws, last[:, 3])


def test_state_is_restored_exactly(world):
    traffic = Traffic(world, np.random.default_rng(0))
    traffic.advance(100, 0.1)
    state = traffic.state_dict()
    expected = traffic.advance(3000, 0.1)
    other = Traffic(world, np.random.default_rng(9))
    other.load_state_dict(state)
    np.testing.assert_array_equal(other.advance(3000, 0.1), expected)
    with pytest.raises(ValueError, match="6 planes"):
        other.load_state_dict({"legs": state["legs"][:2]})


def test_planes_start_spread_over_the_valley():
    starts = np.array([Leg(np.random.default_rng(s), (40.0, 30.0), (2.5, 4.0)).fly(1, 0.0)[0, :2] for s in range(200)])
    inner = (np.abs(starts) < SIZE / 4).all(1).mean()
    assert 0.1 < inner < 0.6


def test_a_leg_ends_where_the_valley_does():
    leg = Leg(np.random.default_rng(0), (40.0, 30.0), (2.5, 4.0))
    direction, rest = leg.direction, leg.length - leg.flown
    last = leg.fly(1, (rest - 1e-6) / leg.speed)[0, :2]
    assert np.isclose(np.abs(last) / (SIZE / 2), 1.0, atol=1e-5).any()
    leg.fly(1, 0.01)
    assert not np.allclose(leg.direction, direction)


def test_static_world_has_no_traffic():
    traffic = Traffic(World(WorldConfig(obstacles=5)), np.random.default_rng(0))
    assert traffic.positions.shape == (0, 3) and traffic.yaws.shape == (0,)
    assert traffic.advance(24, 0.1).shape == (24, 0, 4)


def test_plane_model():
    mesh = plane_mesh(2.0)
    assert_closed(mesh)
    assert 50 <= len(mesh.faces) <= 200
    assert np.ptp(mesh.vertices[:, 1]) == pytest.approx(2.0)
    assert np.ptp(mesh.vertices, axis=0).argmax() == 1
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    assert high[0] > 0 > low[0] and high[2] > -low[2]  # the fin points up
    np.testing.assert_allclose(plane_mesh(3.0).vertices, mesh.vertices * 1.5, rtol=1e-6)


def test_an_environment_shows_the_shape_of_its_planes():
    env = NavigationEnv(1, world=WorldConfig(planes=1, plane_wingspan=3.0))
    np.testing.assert_array_equal(env.plane_mesh.vertices, plane_mesh(3.0).vertices)
    env.close()
