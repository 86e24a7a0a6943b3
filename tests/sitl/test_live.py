"""An episode in pieces: the physics, delays, wind and scans of whole steps, cut finer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.helpers.valleys import SMALL
from uavrl.envs import NavigationEnv, Randomization
from uavrl.envs.lidar import LidarConfig
from uavrl.sitl.live import PIECE, PIECES, LiveEpisode
from uavrl_onboard.lidar.vlp16 import FIRING_TIMES, NUM_RAYS

Make = Callable[..., NavigationEnv]
SHAKEN = Randomization(
    action_delay=(0.05, 0.1), scan_delay=(0.05, 0.1), wind=(1.0, 2.0), gust_intensity=(0.3, 0.5), mass=(1.1, 1.1)
)
PLANES = replace(SMALL, planes=1, plane_wingspan=1.2, plane_keep_out=2.0)


def commands(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (count, 1, 4))


def test_parts_of_a_period_come_to_the_whole_bit_by_bit(make: Make) -> None:
    whole, parts = (make(1, randomize=SHAKEN, world=PLANES) for _ in range(2))
    for env in (whole, parts):
        env.reset(task=3)
    for command in commands(6):
        whole.simulation.step(command, whole.traffic.advance(24, 1 / 240))
        for substeps in (3, 15, 6):
            parts.simulation.step(command, parts.traffic.advance(substeps, 1 / 240), substeps)
        for name in ("position", "velocity", "rotation", "rotor_speed"):
            np.testing.assert_array_equal(getattr(whole.simulation, name), getattr(parts.simulation, name))
        np.testing.assert_array_equal(*(env._scan(np.arange(1)) for env in (whole, parts)))


@pytest.mark.parametrize("substeps", [0, 2, 27])
def test_a_part_is_some_steps_of_the_outer_loop(make: Make, substeps: int) -> None:
    env = make(1)
    env.reset()
    with pytest.raises(ValueError, match="a multiple of 3, at most 24"):
        env.simulation.step(np.zeros((1, 4)), None, substeps)


@pytest.mark.parametrize("reach", [4.0, 100.0])  # with and without culling
def test_a_turn_in_pieces_is_a_scan_where_nothing_moves(make: Make, reach: float) -> None:
    env = make(1, lidar=LidarConfig(max_range=reach))
    episode = LiveEpisode(env, 0)
    before, cast = episode.points, []
    for _ in range(PIECES):
        cast.append(episode.piece(np.zeros(3), 0.0))
    assert [(rays.start, rays.stop) for rays in cast][:2] == [(0, 228 * 16), (228 * 16, 454 * 16)]
    assert all(one.stop == two.start for one, two in pairwise(cast)) and cast[-1].stop == NUM_RAYS
    np.testing.assert_allclose(episode.points, before, atol=1e-4)


def test_each_ray_is_cast_in_the_piece_in_which_it_is_fired(make: Make) -> None:
    episode = LiveEpisode(make(1), 0)
    for piece in range(PIECES - 1):
        rays = episode.piece(np.zeros(3), 0.0)
        fired = FIRING_TIMES[rays]
        assert piece * PIECE - 1e-4 <= fired[0] and fired[-1] <= (piece + 1) * PIECE + 1e-4


@pytest.mark.parametrize("name", ["xt32", "mid360", "rplidar", "d435"])
def test_a_turn_of_any_lidar_in_pieces_is_a_scan_where_nothing_moves(make: Make, name: str) -> None:
    config = LidarConfig(sensor=name, range_noise=0.0)
    env = make(1, lidar=config)
    episode, times = LiveEpisode(env, 5), config.device.rays.times
    for turn in range(2):
        whole = env.look(slice(None), 5 + turn)[0]
        cast = [episode.piece(np.zeros(3), 0.0) for _ in range(PIECES)]
        assert [cast[0].start, cast[-1].stop] == [0, len(times)]
        for number, rays in enumerate(cast):
            assert ((times[rays] >= number * PIECE) & (times[rays] < (number + 1) * PIECE)).all()
        np.testing.assert_allclose(episode.points, whole, atol=1e-3)
        assert np.isfinite(whole).any()
    assert episode.last_firing == times[-1]


def test_its_points_are_in_the_axes_of_a_sensor_that_is_mounted_otherwise(make: Make) -> None:
    mount = (180.0, 20.0, 90.0)
    env = make(1, lidar=LidarConfig(sensor={"like": "xt32", "mount": list(mount)}, range_noise=0.0))
    episode, turn = LiveEpisode(env, 5), Rotation.from_euler("xyz", mount, degrees=True)
    for _ in range(2):  # of the reset, then of a turn in pieces
        np.testing.assert_allclose(turn.apply(episode.points), env.look(slice(None), 5)[0], atol=1e-3)
        for _ in range(PIECES):
            episode.piece(np.zeros(3), 0.0)
    assert np.isfinite(episode.points).any()


def test_a_pattern_that_changes_does_so_from_turn_to_turn(make: Make) -> None:
    episode, seen = LiveEpisode(make(1, lidar=LidarConfig(sensor="mid360", range_noise=0.0)), 0), []
    for _ in range(2):
        for _ in range(PIECES):
            episode.piece(np.zeros(3), 0.0)
        hit = episode.points[np.isfinite(episode.points[:, 0])]
        seen.append(np.unique(np.round(hit / np.linalg.norm(hit, axis=1, keepdims=True), 4), axis=0))
    assert len(np.unique(np.concatenate(seen), axis=0)) > 1.5 * max(map(len, seen))


def test_a_velocity_in_the_worlds_axes_stays_there_while_the_vehicle_turns(make: Make) -> None:
    world = replace(SMALL, obstacles=0)
    episode = LiveEpisode(make(1, world=world), 0)
    towards = episode.goal[:2] - episode.motion.position[:2]
    velocity = np.append(0.8 * towards / np.linalg.norm(towards), 0.0)
    distance = episode.distance
    for _ in range(8 * PIECES):
        episode.piece(velocity, 1.5)
    yaw = episode.motion.yaw
    for _ in range(4 * PIECES):
        episode.piece(velocity, 1.5)
    later = episode.motion
    assert math.remainder(later.yaw - yaw - 1.5 * 0.4, math.tau) == pytest.approx(0.0, abs=0.05)
    np.testing.assert_allclose(later.velocity, velocity, atol=0.05)
    assert episode.distance < distance - 0.6


def test_the_motion_is_from_the_valleys_origin_and_as_the_estimator_believes_it(make: Make) -> None:
    biased = Randomization(altitude_bias=(0.2, 0.2), heading_bias=(0.1, 0.1))
    env = make(1, world=replace(SMALL, seeds=(0, 1)), randomize=biased)
    episode = LiveEpisode(env, 1)
    simulation = env.simulation
    valley = next(valley for valley in env.world.places if valley.seed == episode.world_seed)
    true = simulation.position[0] - np.append(valley.origin, 0.0)
    np.testing.assert_allclose(episode.motion.position, true + np.array([0.0, 0.0, 0.2]))
    assert episode.motion.yaw == pytest.approx(math.remainder(simulation.yaw[0] + 0.1, math.tau))
    assert (np.abs(episode.goal[:2]) < [7.0, 6.0]).all() and episode.goal[2] == pytest.approx(2.5, abs=0.6)


def test_it_ends_with_a_success_or_a_collision(make: Make) -> None:
    world = replace(SMALL, obstacles=0)
    episode = LiveEpisode(make(1, world=world), 0)
    for _ in range(PIECES * 100):
        towards = episode.goal - episode.motion.position
        episode.piece(np.append(2.0 * towards[:2] / np.linalg.norm(towards[:2]), 0.0), 0.0)
        if episode.outcome is not None:
            break
    assert episode.outcome == "success" and np.linalg.norm((episode.goal - episode.motion.position)[:2]) <= 1.0
    episode = LiveEpisode(make(1, world=world), 0)
    episode.stop_motors()
    for _ in range(PIECES * 20):
        episode.piece(np.zeros(3), 0.0)
    assert episode.outcome == "collision"


def test_steps_are_those_of_the_environment(make: Make) -> None:
    episode, env = LiveEpisode(make(1), 2), make(1)
    state = env.reset(task=2)
    np.testing.assert_array_equal(episode.points, state["point_cloud"][0].numpy())
    for command in commands(5)[:, 0].astype(np.float32):
        episode.step(command)
        state = env.step(state.set("action", torch.from_numpy(command)[None]))["next"]
        np.testing.assert_array_equal(episode.points, state["point_cloud"][0].numpy())


def test_it_takes_one_vehicle(make: Make) -> None:
    with pytest.raises(ValueError, match="one vehicle, got 2"):
        LiveEpisode(make(2), 0)
