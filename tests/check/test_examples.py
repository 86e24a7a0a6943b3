"""Examples do what the documentation says of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from uavrl.cli.policies import PACKAGED

EXAMPLES = Path(__file__).parents[2] / "examples"


def said(example: str, *arguments: object) -> str:
    """What an example prints, in a process of its own."""
    command = [sys.executable, EXAMPLES / example, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_backward_reward_is_used_outside_the_valley() -> None:
    assert "arrived" in said("backward_reward.py", 600)


def test_forks_threshold_is_measured_on_a_run(finished: Path) -> None:
    printed = said("fork_threshold.py", finished, "--updates", 20)
    assert "system loss of predicting no change: 0." in printed
    assert "20 updates: system loss" in printed


def test_altitudes_are_drawn_from_the_packaged_evaluations(tmp_path: Path) -> None:
    printed = said("altitudes.py", PACKAGED / "static" / "evaluation.json", "--output", tmp_path / "altitudes.png")
    low, middle, high = (float(x) for x in printed.split("%: ")[1].split(" m")[0].split(" / "))
    assert 0 < low < middle < high < 5
    assert (tmp_path / "altitudes.png").stat().st_size > 5_000


def test_success_in_each_world_is_drawn_from_what_the_suite_wrote(tmp_path: Path) -> None:
    suites = EXAMPLES.parent / "docs/data/suite"
    picture = tmp_path / "worlds.png"
    said("scenarios.py", f"a rule={suites / 'vfh.json'}", suites / "best.json", "--output", picture)
    assert picture.stat().st_size > 5_000
    drawing = [sys.executable, EXAMPLES / "scenarios.py"]
    for wrong, message in (
        ([PACKAGED / "static" / "evaluation.json"], "Expected worlds with a success each in"),
        ([suites / "best.json", "--worlds", "dence"], "Expected worlds that a file tells of, got dence"),
    ):
        done = subprocess.run([*drawing, *wrong], capture_output=True, text=True, timeout=600)
        assert message in done.stderr
