"""A few short flights over a small valley."""

from __future__ import annotations

from functools import cache

from omegaconf import DictConfig

from tests.composing import composed
from uavrl.configs import to_dataclass
from uavrl.training.baselines import StraightPolicy
from uavrl.training.flight import Replay
from uavrl.training.replay import record_flights

STEPS = 12
SEED = 20_000
PERCEPTION = to_dataclass(composed()).perception


def reward(name: str, *overrides: str) -> DictConfig:
    return to_dataclass(composed("config", f"reward={name}", *overrides)).reward


REWARD = reward("navigation_prize")


def small_env(planes: int = 0, steps: int = STEPS) -> DictConfig:
    world = ["seeds=[3,4]", "size=[26.0,20.0]", "obstacles=6", f"planes={planes}"]
    overrides = [f"env.world.{value}" for value in world]
    return to_dataclass(composed("config", f"env.max_steps={steps}", *overrides)).env


@cache
def small_replay(planes: int = 2, tasks: tuple[int, ...] = (0, 5)) -> Replay:
    policy = StraightPolicy(3.5)
    source = {"policy": "straight", "env": "small", "seed": SEED}
    return record_flights(
        small_env(planes), PERCEPTION, policy, tasks, seed=SEED, source=source, reward=REWARD, max_points=100_000
    )
