"""A model card shows what was measured with this checkpoint and nothing else; its metadata are those of model hubs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from uavrl.errors import UavrlError
from uavrl.evaluation.policies import PACKAGED, packaged_policies
from uavrl.export.model_card import Statements, model_card, read_evaluations, read_statements, write_card
from uavrl.runs.config import read_config
from uavrl_onboard.policy.contract import read_contract

ABOUT = {"checkpoint": "c1", "training_steps": 1000, "training_episodes": 12, "commit": "abc"}


def result(success: float, **more: Any) -> dict[str, Any]:
    rate = {"rate": success, "low": success - 0.1, "high": success + 0.05}
    zero = {"rate": 0.0, "low": 0.0, "high": 0.02}
    same = {"checkpoint": "c1", "training_steps": 1000}
    return {"episodes": 40, "success": rate, "collision": zero, "time_out": zero, **same, **more}


def card(evaluations: dict[str, Any], said: Statements | None = None) -> tuple[dict[str, Any], str]:
    """The metadata and the text of a card."""
    folder = PACKAGED / "best"
    written = model_card("mine", ABOUT, read_config(folder), read_contract(folder), evaluations, said)
    empty, metadata, text = written.split("---\n", 2)
    assert empty == ""
    return yaml.safe_load(metadata), text


@pytest.mark.parametrize("name", packaged_policies())
def test_the_card_of_a_packaged_policy_is_that_of_its_files(name: str, tmp_path: Path) -> None:
    for file in (PACKAGED / name).iterdir():
        if file.name != "README.md":
            (tmp_path / file.name).write_bytes(file.read_bytes())
    written = write_card(tmp_path, name).read_text(encoding="utf-8")
    assert written == (PACKAGED / name / "README.md").read_text(encoding="utf-8"), "run python -m tools.model_cards"
    suite = json.loads((PACKAGED / name / "suite.json").read_text())
    metadata = yaml.safe_load(written.split("---\n")[1])
    (index,) = metadata["model-index"]
    shown = {row["dataset"]["name"]: row["metrics"][0]["value"] for row in index["results"]}
    assert shown == {f"uavrl {key}": round(100 * row["success"]["rate"], 1) for key, row in suite.items()}
    assert (metadata["license"], metadata["library_name"]) == ("mit", "uavrl")
    assert metadata["pipeline_tag"] == "reinforcement-learning" and "td3" in metadata["tags"]


def test_without_an_evaluation_it_has_no_results_and_without_statements_no_license() -> None:
    metadata, text = card({})
    assert "model-index" not in metadata and "license" not in metadata
    assert "There is no evaluation of this policy yet" in text and "has not chosen a license" in text
    assert "The command line was not recorded" in text and "(95 %" not in text


def test_a_result_has_its_interval_guards_and_keys() -> None:
    guards = {"map": None, "shield": {"margin": 0.1}}
    rows = {"evaluation": result(0.85, guards=guards, overrides=["env=static", "policy=x", "env.world.obstacles=90"])}
    metadata, text = card(rows | {"bare": result(0.5)}, Statements("mit", "uavrl-train", ("For X.",), ("Not for Y.",)))
    assert "| evaluation | 40 | shield | 85.0 (75.0–90.0) | 0.0 (0.0–2.0) | 0.0 (0.0–2.0) |" in text
    assert "- evaluation: `env=static env.world.obstacles=90 episodes=40`" in text
    assert "- bare: `guards=none episodes=40`" in text, "the policy flies with guards by default"
    assert all(said in text for said in ("For X.", "- Not for Y.", "```sh\nuavrl-train\n```", "`mit`", "`abc`"))
    (index,) = metadata["model-index"]
    assert [row["metrics"][0]["value"] for row in index["results"]] == [85.0, 50.0]


def test_evaluations_of_another_checkpoint_and_broken_files_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "suite").mkdir()
    broken = {"success": {"rate": "high"}}
    suite = {"static": result(1.0), "old": result(0.3, checkpoint="c0"), "odd": result(0.4) | broken, "no": 3}
    (tmp_path / "suite/suite.json").write_text(json.dumps(suite))
    (tmp_path / "evaluation.json").write_text(json.dumps(result(0.9)))
    (tmp_path / "evaluation_seed=1.json").write_text(json.dumps(result(0.8, training_steps=999)))
    (tmp_path / "evaluation_seed=2.json").write_text("{")
    (tmp_path / "evaluation_seed=3.json").write_text("[]")
    found = read_evaluations(tmp_path, ABOUT)
    assert {name: row["success"]["rate"] for name, row in found.items()} == {"static": 1.0, "evaluation": 0.9}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("license: [mit]", "each a list of sentences: change license"),
        ("use: For X.", "change use"),
        ("limit: [a]", "change limit"),
        ("- a", "cannot be read as YAML"),
        ("a: [", "cannot be read as YAML"),
    ],
)
def test_statements_of_another_form_are_refused(content: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "card.yaml").write_text(content)
    with pytest.raises(UavrlError, match=said):
        read_statements(tmp_path)
