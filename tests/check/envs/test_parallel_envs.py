"""Environments in other processes: the valley, and every transform around an environment of its contract."""

from __future__ import annotations

import importlib
import multiprocessing
import pkgutil
from collections.abc import Callable
from functools import partial

import pytest
from torchrl.envs import EnvBase, ParallelEnv, TransformedEnv, check_env_specs

import tests.transforms
from tests.helpers.contracts import TransformContract
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv

for module in pkgutil.iter_modules(tests.transforms.__path__, "tests.transforms."):
    importlib.import_module(module.name)
CONTRACTS = [contract for contract in TransformContract.__subclasses__() if "transforms" in contract.__module__]
START = "forkserver"  # forks a process that has done nothing yet: a thread of this one may hold a lock
multiprocessing.set_forkserver_preload(["torchrl.envs", "uavrl.envs.navigation", "uavrl.transforms"])


def transformed(contract: type[TransformContract]) -> EnvBase:
    return TransformedEnv(contract.make_env(), contract().make_transform())


def two_uavs() -> EnvBase:
    return NavigationEnv(2, lidar=LidarConfig(max_range=4.0))


MAKERS = {
    "tests.envs": two_uavs,
    **{f"{each.__module__}.{each.__name__}": partial(transformed, each) for each in CONTRACTS},
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_specs_hold_in_two_processes(make: Callable[[], EnvBase]) -> None:
    env = ParallelEnv(2, make, mp_start_method=START)
    try:
        check_env_specs(env)
    finally:
        env.close()


def test_all_transforms_are_tried() -> None:
    assert len(CONTRACTS) >= 6
