"""What all tests share."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import numpy as np
import pytest

from uavrl.envs import world

_VALLEYS: dict[str, world.Valley] = {}


@pytest.fixture(scope="session", autouse=True)
def interrupts_are_heard() -> None:
    """A shell's background jobs do not hear Ctrl-C: the tests that send it do."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="module", autouse=True)
def valleys_built_once() -> Iterator[None]:
    """Many tests fly in the same few valleys; tests/envs/test_world.py, which tests their building, builds anew."""
    build = world.build_valley

    def build_once(config: world.WorldConfig, seed: int, origin: np.ndarray) -> world.Valley:
        key = repr((config, seed, origin.tolist()))
        if key not in _VALLEYS:
            _VALLEYS[key] = build(config, seed, origin)
        return _VALLEYS[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world, "build_valley", build_once)
        yield
