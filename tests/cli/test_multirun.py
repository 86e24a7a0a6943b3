"""A sweep trains one run for each combination of values; tests/check has what becomes of it when it is begun again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.helpers.sweeps import runs_in, sweep


def test_each_value_of_a_sweep_gets_its_own_run(tmp_path: Path) -> None:
    assert sweep(tmp_path, "seed=0,1") == 0
    runs = runs_in(tmp_path)
    assert sorted(runs) == [0, 1]
    assert [OmegaConf.load(runs[seed] / "config.yaml").run_dir for seed in (0, 1)] == [str(runs[0]), str(runs[1])]
    summaries = [json.loads((runs[seed] / "summary.json").read_text()) for seed in (0, 1)]
    assert [s["seed"] for s in summaries] == [0, 1]
    assert [s["episodes"] for s in summaries] == [4, 4]
    assert summaries[0]["mean_return"] != summaries[1]["mean_return"]
    for run in runs.values():
        assert list((run / "checkpoints").glob("checkpoint*"))
        assert len((run / "episodes.csv").read_text().splitlines()) == 1 + 4


def test_resume_in_a_sweep_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sweep(tmp_path, "resume=one,two") == 1
    assert "leave out -m and experiment" in capsys.readouterr().err
    assert not list(tmp_path.glob("run*"))
