"""An exported policy with a memory carries it from scan to scan, and begins each episode without one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.helpers.exported import edit_contract, exported, refusal
from uavrl.evaluation.actor import load_actor
from uavrl_onboard.policy.policy import Policy

RECURRENT = ["recurrent=gru", "recurrent.size=8", "algo.hidden=[16]", "perception.frames=1"]
STEPS = 12


@pytest.fixture(scope="module", params=["td3", "sac"])
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp(request.param), f"algo={request.param}", *RECURRENT)


def scans(seed: int) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [generator.uniform(-4, 4, (60, 3)) for _ in range(STEPS)]


def flown(policy: Policy, clouds: list[np.ndarray]) -> np.ndarray:
    return np.stack([policy(cloud, 3.0, 10.0 * step, 0.0) for step, cloud in enumerate(clouds)])


def test_it_acts_as_the_policy_does_that_was_exported(folder: Path) -> None:
    _, actor, _ = load_actor(folder, None, "cpu")
    onboard, reads = Policy(folder), Policy(folder)
    state, begins = torch.zeros(1, 1, 8), torch.ones(1, 1, dtype=torch.bool)
    for step, cloud in enumerate(scans(0)):
        action = onboard(cloud, 3.0, 10.0 * step, 0.0)
        seen = torch.from_numpy(reads.state(cloud, 3.0, 10.0 * step, 0.0))[None]
        read = TensorDict({"observation": seen, "recurrent_state": state, "is_init": begins}, [1])
        with torch.no_grad():
            acted = actor.eval()(read)
        wanted = acted["action"] if "loc" not in acted else 2 * acted["loc"].tanh()
        np.testing.assert_allclose(action, wanted[0].numpy(), atol=1e-4)
        state, begins = acted["next", "recurrent_state"], torch.zeros_like(begins)
    assert state.abs().max() > 0.05


def test_what_came_before_matters_until_the_next_episode(folder: Path) -> None:
    policy, clouds = Policy(folder), scans(1)
    first = flown(policy, clouds)
    again = flown(policy, clouds)
    policy.reset()
    anew = flown(policy, clouds)
    assert np.abs(first - again).max() > 1e-3
    np.testing.assert_array_equal(first, anew)
    np.testing.assert_array_equal(first, flown(policy.copy(), clouds))


def test_the_contract_says_what_is_carried(folder: Path) -> None:
    memory = json.loads((folder / "contract.json").read_text())["network"]["memory"]
    assert {key: memory[key] for key in ("input", "output", "size", "initial")} == {
        "input": "memory",
        "output": "next_memory",
        "size": 8,
        "initial": 0.0,
    }
    assert "take-off" in memory["does"]


@pytest.mark.parametrize("change", [{"size": 9}, {"input": "other"}, {"output": "action"}])
def test_a_contract_of_another_memory_is_refused(change: dict[str, object], folder: Path) -> None:
    terms = json.loads((folder / "contract.json").read_text())
    said = refusal(folder, terms, lambda changed: changed["network"]["memory"].update(change))
    edit_contract(folder, lambda changed: changed.update(terms))
    assert "which is not what contract.json says" in said
