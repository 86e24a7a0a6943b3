"""What a configuration gives as shares of the run is worked out when it is validated."""

from __future__ import annotations

from typing import Any

import pytest

from uavrl.config import compose, resolve, validate
from uavrl.errors import UavrlError

SHARES = "algo.actor_lr_decay=[0.5,1.0]"
CLONES = ("preset=dagger", "trainer.steps=40000")


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["preset=td3_bc"], [50_000, 100_000]),  # the demonstrator's steps are learned from, too
        (["preset=td3_bc", "trainer.steps=40000", "trainer.updates_per_step=0.25"], [5000, 10_000]),
        ([SHARES, "trainer.steps=30000", "algo.learning_starts=10000"], [10_000, 20_000]),  # after random steps
        ([*CLONES, "cloning.steps=30000"], [5000, 10_000]),  # after the cloning phase
        (CLONES, None),  # which is all of the run
        (["preset=dagger", "cloning=none"], [15_000, 30_000]),
        (["preset=td3_bc", "algo.actor_lr_decay=[60000,80000]", "trainer.steps=null"], [60_000, 80_000]),
        (["preset=td3_bc", "experiment=sixteen_valleys"], None),
    ],
)
def test_the_learning_rate_falls_between_these_updates(words: Any, found: list[int] | None) -> None:
    decay = validate(compose("run_dir=x", *words)).algo["actor_lr_decay"]
    assert (decay if decay is None else [*decay]) == found


@pytest.mark.parametrize(
    ("words", "lasts"),
    [
        (["preset=dagger"], 30_000),
        (["preset=dagger", "trainer.steps=500"], 500),
        ([*CLONES, "cloning.steps=700"], 700),
        (["preset=dagger", "trainer.steps=null", "algo.actor_lr_decay=null"], 30_000),
    ],
)
def test_a_cloning_phase_lasts_for_all_of_the_run_unless_told_otherwise(words: Any, lasts: int) -> None:
    assert validate(compose("run_dir=x", *words)).cloning["steps"] == lasts


def test_a_run_keeps_what_was_worked_out_if_it_goes_on_for_longer() -> None:
    config = resolve(compose("run_dir=x", "preset=td3_bc", "cloning=dagger", "cloning.steps=null"))
    assert (config.cloning.steps, config.algo.actor_lr_decay) == (100_000, None)
    config = resolve(compose("run_dir=x", "preset=td3_bc"))
    config.trainer.steps = 200_000
    assert [*validate(config).algo["actor_lr_decay"]] == [50_000, 100_000]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["preset=td3_bc", "trainer.steps=null"], "algo.actor_lr_decay=[0.5, 1.0] are shares of the run, and a run"),
        ([SHARES.replace("1.0", "1.5")], "algo.actor_lr_decay must be two shares of the run, up to 1, or two whole"),
        ([SHARES.replace("0.5,1.0", "5,3")], "algo.actor_lr_decay must be two shares of the run, up to 1, or two"),
    ],
)
def test_what_is_neither_is_refused_in_a_sentence(words: Any, said: str) -> None:
    with pytest.raises(UavrlError) as caught:
        validate(compose("run_dir=x", *words))
    assert said in str(caught.value) and "\n" not in str(caught.value)
