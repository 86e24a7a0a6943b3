"""Copies of an environment: each has a physics of its own and goes on from the same state."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import Compose, EnvBase, TransformedEnv

from tests.helpers.valleys import NEAR, SMALL, act
from uavrl import load_policy
from uavrl.envs import NavigationEnv, Randomization
from uavrl.envs.bullet import pybullet
from uavrl.envs.gym import ValleyEnv
from uavrl.envs.gym_vector import ValleyVectorEnv
from uavrl.envs.simulation import Simulation
from uavrl.errors import UavrlError
from uavrl.sitl.live import LiveEpisode
from uavrl.transforms import NavigationReward, NavigationState

Copy = Callable[[Any], Any]
COPIES = [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]
PLANES = replace(SMALL, planes=2, plane_keep_out=2.0)
SHAKEN = Randomization(
    mass=(0.8, 1.2),
    action_delay=(0.05, 0.1),
    scan_delay=(0.05, 0.1),
    gust_intensity=(0.3, 0.5),
    range_noise=(0.01, 0.02),
)
both_ways = pytest.mark.parametrize("copied", COPIES, ids=["deepcopy", "pickle"])


def fly(env: EnvBase, state: TensorDictBase, steps: int) -> list[TensorDictBase]:
    """The states after random actions, each followed by its reset."""
    rng, seen = np.random.default_rng(0), []
    for _ in range(steps):
        state = env.step_and_maybe_reset(act(state, *rng.uniform(-2, 2, 4).tolist()))[1]
        seen.append(state.clone())
    return seen


def require_alike(one: list[TensorDictBase], other: list[TensorDictBase], atol: float = 1e-4) -> None:
    for first, second in zip(one, other, strict=True):
        for key in ("position", "velocity", "attitude", "goal", "task", "done"):
            torch.testing.assert_close(first[key], second[key], atol=atol, rtol=0)


def bodies(simulation: Simulation) -> list[Any]:
    at = {"physicsClientId": simulation._client}
    return [
        (pybullet.getBasePositionAndOrientation(body, **at), pybullet.getBaseVelocity(body, **at))
        for body in simulation._vehicles
    ]


@both_ways
def test_a_copy_flies_on_from_the_same_state_and_leaves_the_original_where_it_is(
    copied: Copy, make: Callable[..., NavigationEnv]
) -> None:
    """With planes, noise, delays and vehicles of their own."""
    env = make(2, world=PLANES, randomize=SHAKEN)
    state = fly(env, env.reset(), 4)[-1]
    other, before = copied(env), bodies(env.simulation)
    assert other.simulation._client != env.simulation._client
    np.testing.assert_allclose(other.simulation.position, env.simulation.position, atol=1e-12)
    np.testing.assert_allclose(other.plane_poses(), env.plane_poses(), atol=1e-12)
    flown = fly(other, state.clone(), 6)
    assert bodies(env.simulation) == before, "the original has not moved"
    require_alike(fly(env, state, 6), flown)
    for clouds in zip(flown, fly(copied(other), flown[-1].clone(), 1), strict=False):
        assert clouds[0]["point_cloud"].shape == clouds[1]["point_cloud"].shape
    other.close()


def test_pushing_a_copy_does_not_move_the_original(make: Callable[..., NavigationEnv]) -> None:
    env = make(1)
    env.reset()
    other = copy.deepcopy(env)
    body = other.simulation._vehicles[0]
    pybullet.resetBaseVelocity(body, (3, 0, 0), (0, 0, 0), physicsClientId=other.simulation._client)
    assert bodies(env.simulation)[0][1] == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    env.close()
    assert other.step(act(other.reset()))["next", "position"].isfinite().all(), "closing the original leaves the copy"
    other.close()


@both_ways
def test_a_copy_before_the_first_reset_meets_the_same_tasks(copied: Copy, make: Callable[..., NavigationEnv]) -> None:
    env = make(2)
    env.set_seed(5)
    other = copied(env)
    states = [each.reset() for each in (env, other)]
    for key in ("position", "goal", "world_seed", "task"):
        assert torch.equal(states[0][key], states[1][key])
    other.close()


@pytest.mark.parametrize("reset", [False, True])
@both_ways
def test_a_transformed_environment_is_copied_with_its_frames(
    copied: Copy, reset: bool, make: Callable[..., NavigationEnv]
) -> None:
    env = TransformedEnv(make(2), Compose(NavigationState(), NavigationReward()))
    state = fly(env, env.reset(), 2)[-1] if reset else None
    other = copied(env)
    states = [state.clone() if state is not None else each.reset() for each in (env, other)]
    assert env.base_env is not other.base_env
    for one, two in zip(fly(env, states[0], 4), fly(other, states[1], 4), strict=True):
        torch.testing.assert_close(one["observation"], two["observation"], atol=1e-4, rtol=0)
    other.close()


@both_ways
def test_the_environment_of_a_policy_is_copied(copied: Copy) -> None:
    policy = load_policy("best")
    env = policy.make_env("env.world.obstacles=5", num_uavs=2, guards="all")
    other = copied(env)
    assert torch.equal(env.reset()["position"], other.reset()["position"])
    state = env.step(policy(env.reset()))["next"]
    third = copied(env)
    steps = [each.step(policy(state.clone()))["next", "observation"] for each in (env, third)]
    torch.testing.assert_close(*steps, atol=1e-4, rtol=0)
    for each in (env, other, third):
        each.close()


@both_ways
def test_gymnasiums_environments_are_copied_with_their_cameras(copied: Copy) -> None:
    for env in (
        gymnasium.make("uavrl:uavrl/Valley-v0", world=SMALL, render_mode="rgb_array"),
        ValleyVectorEnv(1, world=SMALL, render_mode="rgb_array"),
    ):
        action = np.full(env.action_space.shape, 0.5, dtype=np.float32)
        fresh = copied(env)
        start = env.reset(seed=2)[0]
        np.testing.assert_array_equal(fresh.reset(seed=2)[0], start)
        drawn = env.render()
        other = copied(env)
        np.testing.assert_array_equal(np.array(other.render()), np.array(drawn))
        for _ in range(3):
            moved = other.step(action)[0]
        assert (moved != start).any()
        np.testing.assert_array_equal(np.array(env.render()), np.array(drawn), "the original has not moved")
        for _ in range(3):
            again = env.step(action)[0]
        np.testing.assert_allclose(again, moved, atol=1e-4)
        for each in (env, fresh, other):
            each.close()


def test_a_live_episode_is_copied(make: Callable[..., NavigationEnv]) -> None:
    episode = LiveEpisode(make(1), 0)
    other = copy.deepcopy(episode)
    for _ in range(8):
        other.piece(np.array([0.5, 0.0, 0.0]), 0.0)
    assert np.linalg.norm(episode.motion.velocity) < 1e-6 < np.linalg.norm(other.motion.velocity)
    other._env.close()


def test_shallow_copies_are_independent_too(make: Callable[..., NavigationEnv]) -> None:
    env = make(1)
    env.reset()
    other = copy.copy(env)
    other.step(act(other.reset(), 2.0, 0.0, 0.0, 0.0))
    assert np.linalg.norm(env.simulation.velocity) < 1e-6
    assert copy.copy(env.simulation).rotor_speed is not env.simulation.rotor_speed
    other.close()


def test_copies_of_copies_are_freed(make: Callable[..., NavigationEnv]) -> None:
    env = make(1)
    env.reset()
    clients = []
    for _ in range(3):
        other = copy.deepcopy(env)
        clients.append(other.simulation._client)
        other.close()
    assert not any(pybullet.getConnectionInfo(physicsClientId=client)["isConnected"] for client in clients)


def test_a_simulation_that_was_closed_is_not_copied() -> None:
    simulation = Simulation([], 1)
    simulation.close()
    with pytest.raises(UavrlError, match="closed cannot be copied or pickled: make a new one"):
        copy.deepcopy(simulation)


def test_the_gym_environment_is_copied_with_its_generator() -> None:
    env = ValleyEnv(world=SMALL, lidar=NEAR)
    env.reset(seed=3)
    other = copy.deepcopy(env)
    assert other.np_random.integers(1000) == env.np_random.integers(1000)
    np.testing.assert_array_equal(other.reset()[1]["goal"], env.reset()[1]["goal"])
    env.close()
    other.close()
