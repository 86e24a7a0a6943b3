"""A test that waits without end is ended, whatever has failed before, and says where it was."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.folders import ROOT

FAILS_AND_HANGS = {
    "in its second try": """
import time, pytest, uavrl.envs  # as the fixtures do, whose set-up is watched, too
tries = []
@pytest.mark.flaky(reruns=1)
def test_it():
    tries.append(1)
    assert len(tries) > 1
    time.sleep(120)
""",
    "while it is taken down": """
import time, pytest, uavrl.envs  # as the fixtures do, whose set-up is watched, too
@pytest.fixture
def slow():
    yield
    time.sleep(120)
def test_it(slow):
    assert False
""",
}


@pytest.mark.parametrize("when", FAILS_AND_HANGS)
def test_a_failed_test_that_then_hangs_is_ended(when: str, tmp_path: Path) -> None:
    script = tmp_path / "test_hangs.py"
    script.write_text(FAILS_AND_HANGS[when], encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-p", "conftest", "-c", ROOT / "pyproject.toml", script]
    command += ["-o", "faulthandler_timeout=8", "-p", "no:cacheprovider"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=300, check=False)
    assert done.returncode == 1 and "Timeout (0:00:08)!" in done.stderr and "test_hangs.py" in done.stderr
