"""A sweep trains one run for each combination of values; tests/check has what becomes of it when it is begun again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hydra.errors import MissingConfigException
from omegaconf import OmegaConf

from tests.helpers.sweeps import runs_in, sweep
from uavrl.cli.command import explained


def test_each_value_of_a_sweep_gets_its_own_run(tmp_path: Path) -> None:
    assert sweep(tmp_path, "seed=0,1") == 0
    runs = runs_in(tmp_path)
    assert [runs[seed].name for seed in (0, 1)] == ["run_seed=0", "run_seed=1"]
    assert [OmegaConf.load(runs[seed] / "config.yaml").run_dir for seed in (0, 1)] == [str(runs[0]), str(runs[1])]
    summaries = [json.loads((runs[seed] / "summary.json").read_text()) for seed in (0, 1)]
    assert [s["seed"] for s in summaries] == [0, 1]
    assert [s["episodes"] for s in summaries] == [4, 4]
    assert summaries[0]["mean_return"] != summaries[1]["mean_return"]
    for run in runs.values():
        assert list((run / "checkpoints").glob("checkpoint*"))
        assert len((run / "episodes.csv").read_text().splitlines()) == 1 + 4


def test_a_launcher_that_is_not_installed_is_named_with_what_to_install() -> None:
    for launcher in ("joblib", "submitit_slurm"):
        error = MissingConfigException("none", f"hydra/launcher/{launcher}", ["basic"])
        told = f"got '{launcher}'. joblib, submitit_local and submitit_slurm come with pip install 'uavrl[launchers]'."
        assert explained(error, "config") == f"hydra/launcher must be one of basic, {told}"
    near = explained(MissingConfigException("none", "hydra/launcher/basics", ["basic"]), "config")
    assert near.startswith("hydra/launcher must be one of basic, got 'basics': did you mean basic?")


def test_a_job_of_a_cluster_that_was_cut_off_is_told_with_how_to_go_on() -> None:
    submitit = pytest.importorskip("submitit.core.utils")
    killed = submitit.FailedJobError("Job 7_0 (task: 0) has not produced any output (state: TIMEOUT)\nError stream …")
    for error in (submitit.UncompletedJobError("Job not requeued because: timed-out too many times."), killed):
        told = explained(error, "config")
        assert told.startswith(f"A job of the sweep did not finish ({str(error).splitlines()[0].rstrip('.')}): ")
        assert "start the same command again" in told and told.count("\n") == 0


def test_resume_in_a_sweep_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sweep(tmp_path, "resume=one,two") == 1
    assert "drop -m and experiment=" in capsys.readouterr().err
    assert not list(tmp_path.glob("run*"))
