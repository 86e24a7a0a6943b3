"""What was built is freed: by close, by a collector's shutdown and by the garbage collector; nothing flies after it."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torchrl.collectors import Collector

from uavrl.envs.bullet import mesh_shape, pybullet
from uavrl.envs.gym import ValleyEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.simulation import Simulation
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh

SMALL = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=5.0)


def small_env() -> NavigationEnv:
    return NavigationEnv(1, world=SMALL, lidar=LidarConfig(max_range=4.0))


def connected(client: int) -> bool:
    return bool(pybullet.getConnectionInfo(physicsClientId=client)["isConnected"])


def parts(env: NavigationEnv) -> tuple[int, list[weakref.ref]]:
    """The PyBullet client of an environment, and references to all else that it has built."""
    env.reset()
    return env.simulation._client, [weakref.ref(each) for each in (env.simulation, env._lidar, env.world, env.traffic)]


def test_close_frees_all_and_a_step_after_it_is_refused() -> None:
    env = small_env()
    state = env.reset()
    client, built = parts(env)
    assert connected(client) and not env.is_closed
    env.close()
    gc.collect()
    assert not connected(client) and all(ref() is None for ref in built)
    state["action"] = torch.zeros(1, 4)
    for call in (lambda: env.step(state), env.reset, lambda: env.simulation, env.plane_poses):
        with pytest.raises(UavrlError, match="closed and has freed its simulation: make a new one"):
            call()  # type: ignore[operator]
    env.close()


def shut_down(env: NavigationEnv) -> None:
    collector = Collector(env, None, frames_per_batch=1, total_frames=1)
    assert sum(batch.numel() for batch in collector) == 1
    collector.shutdown()


@pytest.mark.parametrize("end", [shut_down, lambda env: None])
def test_a_collectors_shutdown_and_the_garbage_collector_free_it(end: Callable[[NavigationEnv], None]) -> None:
    env = small_env()
    client, built = parts(env)
    end(env)
    del env
    gc.collect()
    assert not connected(client) and all(ref() is None for ref in built)


def test_a_simulation_that_nobody_needs_leaves_pybullet() -> None:
    simulation = Simulation([], 1)
    client = simulation._client
    del simulation
    gc.collect()
    assert not connected(client)


@pytest.mark.parametrize("create", [pybullet.createCollisionShape, pybullet.createVisualShape])
def test_pybullet_keeps_no_list_of_a_meshs_numbers(create: Callable[..., int]) -> None:
    """It keeps two references to each list that it reads, in 3.2.7: 5 MB of a valley."""
    client = pybullet.connect(pybullet.DIRECT)
    mesh = Mesh(np.random.default_rng(0).normal(size=(999, 3)), np.arange(999).reshape(-1, 3))
    gc.collect()
    before = len(gc.get_objects())
    for _ in range(3):
        assert mesh_shape(create, mesh, physicsClientId=client) >= 0
    gc.collect()
    assert len(gc.get_objects()) - before < 100
    pybullet.disconnect(physicsClientId=client)


def test_the_gym_environment_is_freed_and_refuses_to_step() -> None:
    env = ValleyEnv(world=SMALL, render_mode="rgb_array")
    env.reset(seed=0)
    client = env._base.simulation._client
    env.render()
    env.close()
    assert not connected(client)
    for call in (lambda: env.step(np.zeros(4, np.float32)), env.reset, env.render):
        with pytest.raises(UavrlError, match="closed and has freed its simulation: make a new one"):
            call()  # type: ignore[operator]
