"""How the cost of an environment step grows with UAVs, range, obstacles, planes and processes."""

from __future__ import annotations

import copy
import time
from functools import partial

from flights import flights, flying, measure, settings
from torchrl.collectors import Collector, RandomPolicy

from uavrl.config import TrainConfig
from uavrl.evaluation.environment import make_env


def sweep(configs: dict[str, TrainConfig], steps: int, repeats: int) -> dict[str, float]:
    """Milliseconds per UAV step under several configurations, interleaved."""
    collectors = {name: flights(config) for name, config in configs.items()}
    try:
        return measure({name: flying(collector, steps) for name, collector in collectors.items()}, repeats)
    finally:
        for collector in collectors.values():
            collector.shutdown()


def in_processes(processes: int, uavs: int, steps: int) -> float:
    """Wall-clock milliseconds per UAV step with that many environment processes of ``uavs`` UAVs and one thread each.

    Steps are counted as they are flown, not when their flights end, and not put together to flights as elsewhere.
    """
    config = settings(uavs)
    make = [
        partial(make_env, config.env, config.perception, config.reward, seed=seed, num_uavs=uavs)
        for seed in range(processes)
    ]
    probe = make[0]()
    collector = Collector(
        make,
        RandomPolicy(probe.action_spec),
        num_collectors=processes,
        backend="process",
        sync=False,
        frames_per_batch=uavs * config.collector.steps_per_batch,
        total_frames=-1,
        num_threads=1,
        num_sub_threads=1,
    )
    probe.close()
    try:
        batches = iter(collector)
        warm = 0
        while warm < steps:
            warm += next(batches).numel()
        flown, begin = 0, time.perf_counter()
        while flown < 4 * steps:
            flown += next(batches).numel()
        return (time.perf_counter() - begin) / flown * 1e3
    finally:
        collector.shutdown()


def with_range(config: TrainConfig, reach: float) -> TrainConfig:
    """The same with another range of the sensor, which leaves the reduction's result as it is."""
    result = copy.deepcopy(config)
    result.perception.lidar.max_range = reach
    return result


def scaling(uavs: int, steps: int, repeats: int) -> dict[str, dict[str, float]]:
    """All sweeps: milliseconds per UAV step."""
    base = settings(uavs)
    return {
        "UAVs in a world": sweep({str(n): settings(n) for n in (1, 2, 4, 8, 16)}, steps, repeats),
        "range of the sensor, m": sweep(
            {f"{r:g}": with_range(base, r) for r in (4.0, 10.0, 30.0, 100.0)}, steps, repeats
        ),
        "obstacles": sweep({str(n): settings(uavs, obstacles=n) for n in (0, 45, 90, 180)}, steps, repeats),
        "moving planes": sweep({str(n): settings(uavs, planes=n) for n in (0, 3)}, steps, repeats),
        "environment processes": {str(n): in_processes(n, uavs, steps * repeats) for n in (1, 2)},
    }


def print_scaling(tables: dict[str, dict[str, float]]) -> None:
    """Prints each sweep as a table."""
    for title, values in tables.items():
        print(f"\n{title:>32}{'ms per UAV step':>18}{'UAV steps/s':>14}")
        for name, value in values.items():
            print(f"{name:>32}{value:18.3f}{1e3 / value:14.0f}")
