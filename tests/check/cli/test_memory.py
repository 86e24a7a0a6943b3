"""Memory stays flat, however often an environment is rebuilt, made or drawn."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import gymnasium
import pytest

from tests.helpers.measured import measured
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.world import WorldConfig

SMALL = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=5.0)
PAGE = os.sysconf("SC_PAGE_SIZE")  # bytes

_tells = Path("/proc/self/statm").exists()
pytestmark = [measured, pytest.mark.skipif(not _tells, reason="reads what Linux tells of a process")]


def resident() -> float:
    """Memory of this process in MB."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 1e6


def growth(call: Callable[[], object], times: int) -> float:
    """Growth in MB over as many calls, the least of three rounds: only a leak grows in each."""
    for _ in range(5):
        call()
    levels = [resident()]
    for _ in range(3):
        for _ in range(times):
            call()
        levels.append(resident())
    return min(after - before for before, after in pairwise(levels))


def test_two_hundred_rebuilds_take_no_memory() -> None:
    env = NavigationEnv(1, world=SMALL, lidar=LidarConfig(max_range=4.0))

    def rebuild() -> None:
        env.set_seed(0)
        env.reset()

    assert growth(rebuild, 200) < 20.0, "of this valley PyBullet kept 1 MB each time"
    env.close()


@pytest.mark.parametrize("closed", [True, False])
def test_environments_that_are_no_longer_needed_take_no_memory(closed: bool) -> None:
    def use() -> None:
        env = gymnasium.make("uavrl:uavrl/Valley-v0", world=SMALL, render_mode="rgb_array")
        env.reset(seed=0)
        env.render()
        if closed:
            env.close()

    assert growth(use, 30) < 20.0
