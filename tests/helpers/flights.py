"""A few short flights over a small valley."""

from __future__ import annotations

from functools import cache

from omegaconf import DictConfig
from torchrl.envs import TransformedEnv

from tests.helpers.configs import composed
from uavrl.config import validate
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.record import record_flights
from uavrl.evaluation.recording import Recording
from uavrl.policies.baselines import StraightPolicy

STEPS = 12
SEED = 20_000
PERCEPTION = validate(composed()).perception


def reward(name: str, *overrides: str) -> DictConfig:
    return validate(composed("config", f"reward={name}", *overrides)).reward


REWARD = reward("navigation_prize")


def small_env(planes: int = 0, steps: int = STEPS) -> DictConfig:
    world = ["seeds=[3,4]", "size=[26.0,20.0]", "obstacles=6", f"planes={planes}"]
    overrides = [f"env.world.{value}" for value in world]
    return validate(composed("config", f"env.max_steps={steps}", *overrides)).env


def flying_env(
    planes: int = 0, reward: DictConfig | None = None, num_uavs: int = 1, steps: int = STEPS, *seen: str
) -> TransformedEnv:
    """What a flight is recorded in, with overrides of what is seen."""
    perception = validate(composed("config", *seen)).perception if seen else PERCEPTION
    env = small_env(planes, steps)
    return make_env(env, perception, reward, num_uavs=num_uavs, measure_clearance=True, keep_cloud=True)


@cache
def small_recording(planes: int = 2, tasks: tuple[int, ...] = (1, 5)) -> Recording:
    source = {"policy": "straight", "env": "small", "seed": SEED}
    env = flying_env(planes, REWARD)
    try:
        return record_flights(env, StraightPolicy(3.5), tasks, seed=SEED, source=source, max_points=100_000)
    finally:
        env.close()
