"""Trainings that are killed at random moments end bit-identical to one that was left alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SIGKILL_FIRST = 2  # a seed


@pytest.mark.parametrize(("kills", "seed"), [(1, SIGKILL_FIRST), pytest.param(50, 0, marks=pytest.mark.slow)])
def test_kills_leave_no_trace(tmp_path: Path, kills: int, seed: int) -> None:
    command = [
        sys.executable,
        "-m",
        "tests.check.training.killing",
        tmp_path,
        "--kills",
        str(kills),
        "--seed",
        str(seed),
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[3])
    assert done.returncode == 0, done.stderr
    told = done.stdout.splitlines()[-1]
    assert told.startswith("1 kills (1 SIGKILL," if kills == 1 else f"{kills} kills ")
