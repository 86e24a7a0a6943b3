"""The tutorials run as plain scripts, with small sizes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
TUTORIALS = ROOT / "docs" / "tutorials"
SMALL = {
    "small_valley": {"FLIGHTS": "4", "TASKS": "2"},
    "anywhere": {"STEPS": "300"},
    "new_reward": {"FLIGHTS": "6"},
    "take_away": {"FLIGHTS": "1"},
}
SAYS = {
    "small_valley": "last third: ",
    "anywhere": "on the way: risk ",
    "new_reward": "step_cost=0.5: ",
    "take_away": "largest difference to the cells in flight: 0.0",
}

QUICK = ["anywhere"]  # the others fly in the valley, for minutes


def test_every_tutorial_is_run_here() -> None:
    assert {path.stem for path in TUTORIALS.glob("*.py")} - {"shell"} == set(SMALL) == set(SAYS)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in SMALL]
)
def test_it_runs(name: str, tmp_path: Path) -> None:
    found = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, **SMALL[name], "MPLBACKEND": "agg", "PYTHONPATH": found, "TMPDIR": str(tmp_path)}
    script = [sys.executable, "-W", "error::FutureWarning", TUTORIALS / f"{name}.py"]
    done = subprocess.run(script, capture_output=True, text=True, cwd=TUTORIALS, env=environment, timeout=800)
    assert done.returncode == 0, done.stderr
    assert SAYS[name] in done.stdout
    assert "conflicting batch_sizes" not in done.stderr
