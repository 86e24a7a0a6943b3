"""The packaged policies see and act as they did, and fly as well as their evaluation says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file
from scipy.stats import binomtest
from tensordict import TensorDict
from torch.testing import assert_close

from tests.helpers.recorded import SCANS, as_evaluated, evaluation, recorded, reduction, states
from uavrl.config import compose, validate_run
from uavrl.config.values import to_plain
from uavrl.rollout.actor import load_policy
from uavrl.rollout.environment import make_env
from uavrl.rollout.policies import PACKAGED, packaged_policies, with_overrides
from uavrl.rollout.rollout import fly
from uavrl.transforms.icosahedron import truncated_icosahedron
from uavrl.transforms.range_image import range_image

TASKS = 150  # of its evaluation's 500, which are flown again
IMPLAUSIBLE = 1e-3  # so seldom does chance alone bring fewer arrivals than are taken here
CELLS = {"truncated_icosahedron": slice(-35, -3), "range_image": slice(-79, -7)}  # of a state, those of the last frame


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
def test_it_acts_as_it_did_in_recorded_states(name: str) -> None:
    kept, (_, policy) = recorded(name), as_evaluated(name)
    with torch.no_grad():
        action = policy(TensorDict({"observation": kept["observation"]}, [len(kept["observation"])]))["action"]
    assert len(action) > 150 and action.std(0).min() > 0.1
    assert_close(action, kept["action"], atol=1e-4, rtol=0)


def test_a_packaged_policy_is_evaluated_in_randomized_vehicles_and_without_again() -> None:
    def randomized(*overrides: str) -> dict[str, Any]:
        config = load_policy(PACKAGED / "best", None, torch.device("cpu"))[0]
        config.env.randomize = {"mass": [0.5, 0.6]}
        run = validate_run(with_overrides(config, compose(*overrides, name="evaluate"), list(overrides)))
        return {key: value for key, value in to_plain(run.env.randomize).items() if value is not None}

    assert randomized("policy=best") == {"mass": [0.5, 0.6]}  # the run's own
    assert randomized("policy=best", "randomize=delay") == {"action_delay": [0.0, 0.1], "scan_delay": [0.0, 0.1]}
    assert randomized("policy=best", "randomize=none") == randomized("policy=best", "env=static") == {}
    given = ("policy=best", "env=dynamic", "randomize=wind", "env.randomize.wind=null")
    assert randomized(*given) == {"gust_intensity": [0.0, 0.5]}


@pytest.mark.parametrize("name", packaged_policies())
def test_it_reads_recorded_scans_as_it_did(name: str) -> None:
    scans, perception = load_file(SCANS), as_evaluated(name)[0].perception
    assert_close(states(scans, perception), scans[reduction(perception)], atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("cells", "kept"),
    [
        (lambda cloud: truncated_icosahedron(cloud, 4.0, "face"), "truncated_icosahedron"),
        (lambda cloud: range_image(cloud, 4.0, "proximity"), "range_image"),
    ],
)
def test_a_recorded_scan_is_reduced_as_it_was(cells, kept: str) -> None:
    scans = load_file(SCANS)
    was = 4.0 * scans[kept][..., CELLS[kept]]
    assert (was > 0).float().mean() > 0.1
    assert_close(cells(scans["cloud"][:-1]), was, atol=1e-5, rtol=0)


@pytest.mark.slow
@pytest.mark.parametrize("name", packaged_policies())
def test_it_succeeds_as_often_as_its_evaluation_states(name: str) -> None:
    """A rate, since another processor rounds otherwise, which decides some episodes; only too low a one is wrong."""
    stated, (settings, policy) = evaluation(name), as_evaluated(name)
    env = make_env(settings.env, settings.perception, seed=stated["seed"], num_uavs=stated["num_uavs"])
    try:
        outcomes = [flight.outcome for flight in fly(env, policy, TASKS)]
    finally:
        env.close()
    arrived = outcomes.count("arrived")
    chance = binomtest(arrived, TASKS, stated["success"]["rate"], alternative="less").pvalue
    assert chance > IMPLAUSIBLE, f"{arrived} of {TASKS} arrived, {stated['success']['rate']:.1%} are stated"
