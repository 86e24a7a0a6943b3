"""One command packages a policy: all files of its folder, and only with the whole suite of this policy."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file
from tensordict import TensorDict

from tests.helpers import recorded
from tests.helpers.commands import content
from tests.helpers.exported import policy_folder
from tools import package_policy as tool
from uavrl.errors import UavrlError
from uavrl.evaluation.actor import load_actor
from uavrl.evaluation.policies import load_policy
from uavrl.evaluation.suite import scenarios
from uavrl_onboard.policy import explanations
from uavrl_onboard.policy.contract import Contract


@pytest.fixture
def suite(run_dir: Path) -> dict[str, Any]:
    about = load_actor(run_dir, None, "cpu")[2]
    row = {"run": str(run_dir), "episodes": 500, "outcomes": "S" * 500, **about}
    return {name: {**row, "overrides": overrides} for name, overrides in scenarios("all").items()}


@pytest.fixture
def packaged(run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[str, Any]], Path]:
    def package(suite: dict[str, Any]) -> Path:
        (run_dir / "suite").mkdir(exist_ok=True)
        (run_dir / "suite/suite.json").write_text(json.dumps(suite))
        return tool.package("new", run_dir, run_dir / "suite/suite.json")

    monkeypatch.setattr(tool, "PACKAGED", tmp_path / "policies")
    monkeypatch.setattr(tool, "commit", lambda: "0" * 40)
    monkeypatch.setattr(tool, "record_actions", lambda name: None)
    return package


def test_the_folder_is_made_anew(
    packaged: Callable[[dict[str, Any]], Path], suite: dict[str, Any], tmp_path: Path
) -> None:
    old = tmp_path / "policies/new/evaluation.json"
    old.parent.mkdir(parents=True)
    old.write_text("{}")
    folder = packaged(suite)
    names = {"README.md", "config.yaml", "contract.json", "policy.json", "policy.safetensors", "suite.json"}
    assert set(content(folder)) == names
    written = json.loads((folder / "suite.json").read_text())
    assert list(written) == list(scenarios("all")) and "run" not in written["dense"]
    assert written["dense"]["outcomes"] == "S" * 500
    assert json.loads((folder / "policy.json").read_text())["versions"].keys() >= {"commit", "python", "torch"}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda suite: suite.pop("windy"), "no 500 tasks of windy with this policy"),
        (lambda suite: suite["dense"].update(training_steps=1), "dense with this policy (see training_steps)"),
        (lambda suite: suite["real"].update(outcomes="SS"), "real with this policy (see outcomes)"),
        (lambda suite: suite["static"]["overrides"].append("perception.blind=true"), "(see overrides)"),
    ],
)
def test_a_suite_of_something_else_is_refused(
    packaged: Callable[[dict[str, Any]], Path], suite: dict[str, Any], tmp_path: Path, change: Callable, told: str
) -> None:
    suite = json.loads(json.dumps(suite))
    change(suite)
    with pytest.raises(UavrlError) as error:
        packaged(suite)
    assert told in str(error.value)
    assert not (tmp_path / "policies").exists()


def test_changes_are_committed_first(
    packaged: Callable[[dict[str, Any]], Path], suite: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tool, "commit", lambda: "0" * 40 + "-dirty")
    with pytest.raises(UavrlError, match="commit them first"):
        packaged(suite)


def test_one_that_sees_motion_is_packaged_with_its_actions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = policy_folder(tmp_path / "run", "algo.hidden=[8]", "perception=range_image", "perception.motion=12")
    row = {"episodes": 500, "outcomes": "S" * 500, "checkpoint": None, "training_steps": None, "seed": 0}
    suite = {name: {**row, "overrides": overrides} for name, overrides in scenarios("all").items()}
    (tmp_path / "suite.json").write_text(json.dumps(suite))
    monkeypatch.setattr(tool, "commit", lambda: "0" * 40)
    for name, value in {"VEHICLES": 2, "STEPS": 4, "LARGEST": 9000, "PACKAGED": tmp_path / "policies"}.items():
        monkeypatch.setattr(recorded, name, value)
    monkeypatch.setattr(tool, "PACKAGED", recorded.PACKAGED)
    folder = tool.package("new", run, tmp_path / "suite.json")
    terms = json.loads((folder / "contract.json").read_text())
    assert terms["motion"]["max_range"] == 12.0
    kept = load_file(folder / "recorded.safetensors")
    assert kept["observation"].shape[1:] == (terms["state"]["size"],) == (3 * (75 + 21 + 73),)
    with torch.no_grad():
        acted = load_policy(folder)(TensorDict({"observation": kept["observation"]}, [len(kept["action"])]))["action"]
    torch.testing.assert_close(acted, kept["action"])


@pytest.mark.parametrize("policy", ["best", "best_dynamic"])
def test_packaged_contracts_say_what_this_version_would_say(policy: str) -> None:
    told = json.loads((recorded.PACKAGED / policy / "contract.json").read_text(encoding="utf-8"))
    lidar = told["cloud"]["lidar"]
    assert (lidar["outside"], lidar["repeats_means"]) == (explanations.OUTSIDE, explanations.REPEATS)
    assert tuple(lidar["cells_see"]) == Contract.model_validate_json(json.dumps(told)).view
