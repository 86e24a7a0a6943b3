"""The packaged policies see and act as they did, and fly as well as their evaluation says."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import pytest
import torch
from safetensors.torch import load_file
from scipy.stats import binomtest
from tensordict import TensorDict
from torch.testing import assert_close

from tests.helpers.recorded import LARGEST, SCANS, as_evaluated, evaluation, recorded, states, suite
from uavrl.config import compose, validate
from uavrl.evaluation.actor import read_policy
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.overrides import with_overrides
from uavrl.evaluation.policies import PACKAGED, default_guards, packaged_policies
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.evaluation.suite import scenarios
from uavrl.export.export import contract
from uavrl.runs.config import load_config
from uavrl.runs.episodes import LETTERS
from uavrl.transforms.icosahedron import truncated_icosahedron
from uavrl.transforms.range_image import range_image
from uavrl_onboard.values import to_plain

TASKS = 150  # of its evaluation's 500, which are flown again
IMPLAUSIBLE = 1e-3  # so seldom does chance alone bring fewer arrivals than are taken here
CELLS = {"truncated_icosahedron": slice(-35, -3), "range_image": slice(-79, -7)}  # of a state, those of the last frame


FILES = {"policy.json", "policy.safetensors", "config.yaml", "contract.json", "suite.json", "recorded.safetensors"} | {
    "card.yaml",
    "README.md",
}


def about(name: str, file: str = "policy.json") -> dict[str, Any]:
    return json.loads((PACKAGED / name / file).read_text())


def test_these_are_packaged() -> None:
    assert packaged_policies() == ["best", "best_dynamic"]


@pytest.mark.parametrize("name", packaged_policies())
def test_its_folder_holds_all_that_it_should(name: str) -> None:
    assert {file.name for file in (PACKAGED / name).iterdir()} == FILES
    versions = about(name, "contract.json")["versions"]
    assert {"commit", "python", "uavrl", "torch", "torchrl", "tensordict"} <= versions.keys()
    assert {"pybullet", "pybullet-arm64"} & versions.keys() and "dirty" not in versions["commit"]
    assert len(about(name)["commit"]) == 40, "the commit that trained it"


@pytest.mark.parametrize("name", packaged_policies())
def test_its_contract_is_of_these_weights_and_this_configuration(name: str) -> None:
    terms = about(name, "contract.json")
    weights = (PACKAGED / name / "policy.safetensors").read_bytes()
    checksum = hashlib.sha256(weights).hexdigest()
    assert terms["weights_sha256"] == about(name)["weights_sha256"] == checksum
    again = contract(validate(load_config(PACKAGED / name / "config.yaml")), checksum, default_guards(PACKAGED / name))
    assert again is not None
    other = {"versions": None, "sha256": None}
    assert {**json.loads(again.to_text()), **other} == {**terms, **other}
    assert about(name)["shapes"]["module.net.0.weight"][1] == terms["state"]["size"]


@pytest.mark.parametrize("name", packaged_policies())
def test_its_suite_is_of_this_policy_and_tells_how_each_task_ended(name: str) -> None:
    rows, known = suite(name), about(name)
    faster = {"fast4", "fast6"}  # than the packaged policies fly, which are limited to 2 m/s
    assert set(scenarios("all")) - faster <= set(rows) <= set(scenarios("all"))
    for scenario, row in rows.items():
        changed = [each for each in row["overrides"] if not each.startswith(("num_uavs=", "policy="))]
        assert changed == scenarios("all")[scenario]
        assert (row["checkpoint"], row["training_steps"]) == (known["checkpoint"], known["training_steps"])
        assert row["episodes"] == 500 and "flights" not in row
        assert len(row["outcomes"]) == 500 and set(row["outcomes"]) <= set(LETTERS.values())
        assert row["outcomes"].count(LETTERS["arrived"]) / 500 == row["success"]["rate"]


@pytest.mark.parametrize("name", packaged_policies())
def test_it_acts_as_it_did_in_recorded_states(name: str) -> None:
    kept, (_, policy) = recorded(name), as_evaluated(name)
    with torch.no_grad():
        action = policy(TensorDict({"observation": kept["observation"]}, [len(kept["observation"])]))["action"]
    assert len(action) == LARGEST // (4 * (kept["observation"].shape[-1] + 4)) and action.std(0).min() > 0.1
    assert_close(action, kept["action"], atol=1e-4, rtol=0)


def test_a_packaged_policy_is_evaluated_in_randomized_vehicles_and_without_again() -> None:
    def randomized(*overrides: str) -> dict[str, Any]:
        config = read_policy(PACKAGED / "best").config
        config.env.randomize = {"mass": [0.5, 0.6]}
        run = validate(with_overrides(config, compose(*overrides, name="evaluate"), list(overrides)))
        return {key: value for key, value in to_plain(run.env.randomize).items() if value is not None}

    assert randomized("policy=best") == {"mass": [0.5, 0.6]}  # the run's own
    assert randomized("policy=best", "randomize=delay") == {"action_delay": [0.0, 0.1], "scan_delay": [0.0, 0.1]}
    assert randomized("policy=best", "randomize=none") == randomized("policy=best", "env=static") == {}
    given = ("policy=best", "env=dynamic", "randomize=wind", "env.randomize.wind=null")
    assert randomized(*given) == {"gust_intensity": [0.0, 0.5]}


@pytest.mark.parametrize("name", packaged_policies())
def test_it_reads_recorded_scans_as_it_did(name: str) -> None:
    """But for what moves in them: that needs whole scans, and is tested beside what finds it."""
    scans, perception = load_file(SCANS), {**as_evaluated(name)[0].perception, "motion": None}
    assert_close(states(scans, perception), scans[perception["reduction"]], atol=1e-5, rtol=0)


def test_recorded_scans_are_read_by_default_as_they_were() -> None:
    scans, settings = load_file(SCANS), validate(compose())
    assert_close(states(scans, settings.perception), scans["truncated_icosahedron"], atol=1e-5, rtol=0)


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
        outcomes = [flight.outcome for flight in rollout_episodes(env, policy, TASKS)]
    finally:
        env.close()
    arrived = outcomes.count("arrived")
    chance = binomtest(arrived, TASKS, stated["success"]["rate"], alternative="less").pvalue
    assert chance > IMPLAUSIBLE, f"{arrived} of {TASKS} arrived, {stated['success']['rate']:.1%} are stated"
