"""Examples do what the documentation says of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.cli.test_bad_input import TINY, in_process
from uavrl.cli import train as train_command
from uavrl.cli.policies import PACKAGED

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_forks_threshold_is_measured_on_a_run(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert in_process(train_command.main, *TINY, f"run_dir={run}") == 0
    script = [sys.executable, EXAMPLES / "fork_threshold.py", run, "--updates", "20"]
    done = subprocess.run(script, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "system loss of predicting no change: 0." in done.stdout
    assert "20 updates: system loss" in done.stdout


def test_altitudes_are_drawn_from_the_packaged_evaluations(tmp_path: Path) -> None:
    evaluation = PACKAGED / "static" / "evaluation.json"
    script = [sys.executable, EXAMPLES / "altitudes.py", evaluation, "--output", tmp_path / "altitudes.png"]
    done = subprocess.run(script, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    low, middle, high = (float(x) for x in done.stdout.split("%: ")[1].split(" m")[0].split(" / "))
    assert 0 < low < middle < high < 5
    assert (tmp_path / "altitudes.png").stat().st_size > 5_000
