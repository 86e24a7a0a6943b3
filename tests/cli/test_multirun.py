"""``-m`` trains one run for each combination of values, each in a folder of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from omegaconf import OmegaConf

from tests.cli.test_bad_input import TINY


def test_each_value_of_a_sweep_gets_its_own_run(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "uavrl.cli.train", "-m", "seed=0,1", *TINY, f"run_dir={tmp_path / 'run'}"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert result.returncode == 0, result.stderr
    runs = sorted(p.parent for p in tmp_path.glob("*/config.yaml"))
    assert [run.name for run in runs] == ["run_0", "run_1"]
    assert [OmegaConf.load(run / "config.yaml").seed for run in runs] == [0, 1]
    assert [OmegaConf.load(run / "config.yaml").run_dir for run in runs] == [str(run) for run in runs]
    summaries = [json.loads((run / "summary.json").read_text()) for run in runs]
    assert [s["seed"] for s in summaries] == [0, 1]
    assert [s["episodes"] for s in summaries] == [4, 4]
    assert summaries[0]["mean_return"] != summaries[1]["mean_return"]
    for run in runs:
        assert f"Run folder: {run}" in result.stdout
        assert list((run / "checkpoints").glob("checkpoint*"))
        assert len((run / "episodes.csv").read_text().splitlines()) == 1 + 4
