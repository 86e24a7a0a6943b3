"""The configurations that come with uavrl, packaged and recorded, are read as they are."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.configs import changed
from tests.helpers.folders import ROOT, run_folder
from uavrl.config import validate
from uavrl.evaluation.policies import PACKAGED, packaged_policies
from uavrl.reporting.runs import read_run
from uavrl.runs.config import load_config
from uavrl.training.run import resume_config


@pytest.mark.parametrize("name", packaged_policies())
def test_packaged_policies_are_read_without_a_word(name: str, caplog: pytest.LogCaptureFixture) -> None:
    config = load_config(PACKAGED / name / "config.yaml")
    before = config.copy()
    assert validate(config).algo._target_ == config.algo._target_
    assert config == before and not caplog.records


@pytest.mark.parametrize(
    "path", sorted((ROOT / "docs/data/fast").rglob("config.yaml")), ids=lambda path: path.parent.name
)
def test_the_runs_that_the_docs_show_are_read(path: Path) -> None:
    validate(load_config(path))


def test_a_run_of_a_preset_that_there_is_no_longer_is_read_reported_and_resumed(tmp_path: Path) -> None:
    run = run_folder(tmp_path / "run", "aac", {"preset": "fast"})
    assert read_run(run, "run").choices["preset"] == "fast"
    more = resume_config(run, changed(["trainer.episodes=9"]), ["trainer.episodes"])
    assert (more.trainer.episodes, more.choices.preset) == (9, "fast")
    assert validate(more).choices["preset"] == "fast"
