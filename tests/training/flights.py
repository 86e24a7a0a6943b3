"""A few short flights over a small valley."""

from __future__ import annotations

from functools import cache

from uavrl.configs.valley import EnvConfig, NavigationRewardConfig, PerceptionConfig

from uavrl.envs.world import WorldConfig
from uavrl.training.baselines import StraightPolicy
from uavrl.training.flight import Replay
from uavrl.training.replay import record_flights

STEPS = 12
SEED = 20_000
REWARD = NavigationRewardConfig(arrived_reward=200.0)


def small_env(planes: int = 0, steps: int = STEPS) -> EnvConfig:
    world = WorldConfig(seeds=(3, 4), size=(26.0, 20.0), obstacles=6, planes=planes)
    return EnvConfig(max_steps=steps, world=world)


@cache
def small_replay(planes: int = 2, tasks: tuple[int, ...] = (0, 5)) -> Replay:
    policy = StraightPolicy(3.5)
    source = {"policy": "straight", "env": "small", "seed": SEED}
    env, perception = small_env(planes), PerceptionConfig()
    return record_flights(env, perception, policy, tasks, seed=SEED, source=source, reward=REWARD, max_points=100_000)
