"""The packaged policies still fly as well as their evaluation says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from uavrl.cli.policies import PACKAGED, packaged_policies, with_overrides
from uavrl.configs import compose, to_dataclass
from uavrl.flying.flight import fly
from uavrl.runs.episodes import wilson
from uavrl.training.factory import make_env
from uavrl.training.policies import load_policy

TASKS = 20


def evaluation(name: str, file: str = "evaluation.json") -> dict[str, Any]:
    return json.loads((PACKAGED / name / file).read_text())


def test_these_are_packaged() -> None:
    assert packaged_policies() == ["best", "best_dynamic", "dynamic", "static"]


@pytest.mark.parametrize("name", packaged_policies())
def test_its_evaluation_is_of_this_policy(name: str) -> None:
    about = json.loads((PACKAGED / name / "policy.json").read_text())
    for file in Path(PACKAGED / name).glob("evaluation*.json"):
        result = evaluation(name, file.name)
        assert result["checkpoint"] == about["checkpoint"]
        assert result["training_steps"] == about["training_steps"]
        assert result["episodes"] == len(result["flights"]) == 500


@pytest.mark.parametrize("name", packaged_policies())
def test_it_succeeds_as_often_as_its_evaluation_states(name: str) -> None:
    stated = evaluation(name)
    config, policy, _ = load_policy(PACKAGED / name, None, torch.device("cpu"))
    config = with_overrides(config, compose(*stated["overrides"], name="evaluate"), stated["overrides"])
    settings = to_dataclass(config)
    env = make_env(settings.env, settings.perception, seed=stated["seed"], num_uavs=8)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as uavrl-evaluate: a sum over two threads rounds otherwise
    try:
        flights = fly(env, policy, TASKS)
    finally:
        torch.set_num_threads(threads)
        env.close()
    # An interval, since the last digits depend on the processor and may decide a flight, most of all among planes. With
    # one flight more, since where nearly all arrive the interval ends below the last one.
    now = [flight.outcome for flight in flights]
    then = [flight["outcome"] for flight in stated["flights"][:TASKS]]
    arrived = then.count("arrived")
    low, high = wilson(arrived, TASKS)["low"], wilson(min(arrived + 1, TASKS), TASKS)["high"]
    assert low <= now.count("arrived") / TASKS <= high
    assert sum(one == other for one, other in zip(now, then, strict=True)) >= 0.75 * TASKS
