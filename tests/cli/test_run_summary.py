"""What a training that was evaluated and drawn says at its end."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from tests.helpers.folders import run_folder
from uavrl.cli.run_summary import main


def evaluated(folder: Path, name: str, rate: float, when: float, valleys: Sequence[int] = (0,)) -> None:
    success = {"rate": rate, "low": rate - 0.1, "high": rate + 0.1}
    path = folder / name
    path.write_text(json.dumps({"episodes": 100, "valleys": valleys, "success": success}))
    os.utime(path, (when, when))


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """A run that was trained in valleys 0 and 1."""
    run = run_folder(tmp_path / "run", "aac", env__world__seeds=[0, 1])
    (run / "summary.json").write_text(json.dumps({"episodes": 600, "steps": 81_234, "minutes": 7.25}))
    return run


def test_the_newest_evaluation_is_told(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluated(trained, "evaluation.json", 0.5, when=2_000_000_000)
    evaluated(trained, "evaluation_env=dynamic.json", 0.4, when=1_000_000_000)
    assert in_process(main, str(trained)) == 0
    assert capsys.readouterr().out.splitlines() == [
        "Reached: 50 % of 100 fixed tasks without noise (40-60 %), after 600 episodes, 81,234 steps and 7.2 minutes.",
        f"Where:   {trained} (uavrl-evaluate run={trained} suite=all evaluates it in every scenario, "
        "uavrl-export keeps the policy on its own)",
        f"Look:    open {trained}/replay.html in a browser",
    ]


@pytest.mark.parametrize(("valleys", "unseen"), [([100, 101], True), ([100, 1], False)])
def test_so_is_that_it_never_saw_the_valleys(
    valleys: list[int], unseen: bool, trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluated(trained, "evaluation.json", 0.5, when=1_000_000_000, valleys=valleys)
    assert in_process(main, str(trained)) == 0
    assert ("50 % of 100 fixed tasks in valleys that it never saw without" in capsys.readouterr().out) == unseen


def test_a_run_that_has_not_come_so_far_is_told_in_one_sentence(tmp_path: Path, refused: Callable[..., str]) -> None:
    missing = f"uavrl: {tmp_path} holds no evaluation: run uavrl-evaluate run={tmp_path} first."
    assert refused(main, str(tmp_path)) == missing
    evaluated(tmp_path, "evaluation.json", 0.5, when=1_000_000_000)
    assert "summary.json" in refused(main, str(tmp_path))
