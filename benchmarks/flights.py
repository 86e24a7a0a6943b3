"""Whole flights with random actions, as a training collects them, and how they are timed."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from common import experiment
from torchrl.collectors import BaseCollector
from torchrl.envs import EnvBase

from uavrl.config import TrainConfig
from uavrl.evaluation.environment import make_env
from uavrl.losses.networks import make_actor, network_sizes
from uavrl.training.build import make_collector

CPU = torch.device("cpu")
ALWAYS_RANDOM = 2**40  # steps
Row = Callable[[], float]  # returns milliseconds per UAV step


def settings(uavs: int, **world: Any) -> TrainConfig:
    """The default experiment with so many UAVs, other values of its world, and random actions for ever."""
    world_values = [f"env.world.{key}={value}" for key, value in world.items()]
    return experiment(f"env.num_uavs={uavs}", f"algo.learning_starts={ALWAYS_RANDOM}", *world_values)


def flights(config: TrainConfig) -> BaseCollector:
    """The collector of whole flights that a training has."""
    return flights_in(make_env(config.env, config.perception, config.reward, seed=config.seed), config)


def flights_in(env: EnvBase, config: TrainConfig) -> BaseCollector:
    """The same in an environment of its configuration."""
    sizes = network_sizes(env)
    return make_collector(config, env, make_actor(config, sizes, CPU), sizes, CPU)


def flying(collector: BaseCollector, steps: int) -> Row:
    """Flies at least ``steps`` steps at a time, those of unfinished flights included."""
    batches = iter(collector)

    def fly() -> float:
        before, seconds, flown = collector.state_dict()["frames"], 0.0, 0
        while flown < steps:
            begin = time.perf_counter()
            next(batches)
            seconds += time.perf_counter() - begin
            flown = collector.state_dict()["frames"] - before
        return seconds / flown * 1e3

    return fly


def stepping(env: EnvBase, steps: int, uavs: int) -> Row:
    """Return a row that makes so many steps of all vehicles with random actions, the same in every row.

    An episode that ends is followed by the next one.
    """
    generator, state = torch.Generator().manual_seed(0), env.reset()

    def fly() -> float:
        nonlocal state
        actions = torch.rand(steps, uavs, 4, generator=generator) * 2 - 0.5
        begin = time.perf_counter()
        for action in actions:
            state = env.step_and_maybe_reset(state.set("action", action))[1]
        return 1e3 * (time.perf_counter() - begin) / (steps * uavs)

    return fly


def measure(rows: dict[str, Row], repeats: int, warm_up: int = 1) -> dict[str, float]:
    """Returns the median of each row in milliseconds per UAV step."""
    times: dict[str, list[float]] = {name: [] for name in rows}
    for turn in range(-warm_up, repeats):
        for name, run in rows.items():
            value = run()
            if turn >= 0:
                times[name].append(value)
    return {name: float(np.median(values)) for name, values in times.items()}


def mean_of(run: Row, times: int) -> Row:
    """The mean of several runs, as one run."""
    return lambda: float(np.mean([run() for _ in range(times)]))
