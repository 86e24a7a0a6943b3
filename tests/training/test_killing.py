"""Trainings that are killed at random moments end bit-identical to one that was left alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("kills", [1, pytest.param(50, marks=pytest.mark.slow)])
def test_kills_leave_no_trace(tmp_path: Path, kills: int) -> None:
    command = [sys.executable, "-m", "tests.killing", tmp_path, "--kills", str(kills)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith(f"{kills} kills ")
