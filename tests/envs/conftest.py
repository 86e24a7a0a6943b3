"""Environments in a small valley, closed after each test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.helpers.valleys import NEAR, SMALL
from uavrl.envs import NavigationEnv


@pytest.fixture
def make() -> Iterator[Callable[..., NavigationEnv]]:
    made: list[NavigationEnv] = []

    def build(num_uavs: int = 2, **kwargs: Any) -> NavigationEnv:
        made.append(NavigationEnv(num_uavs, **{"lidar": NEAR, "world": SMALL} | kwargs))
        return made[-1]

    yield build
    for env in made:
        env.close(raise_if_closed=False)
