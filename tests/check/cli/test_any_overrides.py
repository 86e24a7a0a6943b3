"""Whatever is written on the command line ends in a start, or in one sentence: no traceback, no folder left behind."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings

from tests.helpers.overrides import ANY, TOLD, Started, before_the_world, ends_well
from uavrl.envs.navigation import NavigationEnv
from uavrl.training.trainer import EpisodeTrainer

FLIGHTS, FLYING = 3, 1.0  # flights, and seconds of them, after which a run counts as started


@contextlib.contextmanager
def a_few_flights() -> Iterator[None]:
    """A run that has flown a little has started."""
    train, record, step = EpisodeTrainer.train, EpisodeTrainer.record, NavigationEnv._step
    clock: dict[str, float] = {}

    def begin(trainer: EpisodeTrainer) -> None:
        clock.update(begin=time.process_time(), flights=0)
        train(trainer)

    def counted(trainer: EpisodeTrainer, batch: Any) -> Any:
        clock["flights"] += 1
        if clock["flights"] > FLIGHTS:
            raise Started
        return record(trainer, batch)

    def timed(env: NavigationEnv, tensordict: Any) -> Any:
        if "begin" in clock and time.process_time() - clock["begin"] > FLYING:
            raise Started
        return step(env, tensordict)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EpisodeTrainer, "train", begin)
        patch.setattr(EpisodeTrainer, "record", counted)
        patch.setattr(NavigationEnv, "_step", timed)
        yield


@settings(TOLD, max_examples=100)
@given(ANY)
def test_any_overrides_end_before_the_world_or_in_one_sentence(overrides: list[str]) -> None:
    ends_well(overrides, before_the_world)


@settings(TOLD, max_examples=30)
@given(ANY)
def test_any_overrides_end_in_a_few_flights_or_in_one_sentence(overrides: list[str]) -> None:
    ends_well(overrides, a_few_flights)


@pytest.mark.slow
@settings(TOLD, max_examples=500, derandomize=False)  # others each time; a failure prints its overrides
@given(ANY)
def test_500_of_any_overrides_end_before_the_world_or_in_one_sentence(overrides: list[str]) -> None:
    ends_well(overrides, before_the_world)


@pytest.mark.slow
@settings(TOLD, max_examples=500, derandomize=False)
@given(ANY)
def test_500_of_any_overrides_end_in_a_few_flights_or_in_one_sentence(overrides: list[str]) -> None:
    ends_well(overrides, a_few_flights)
