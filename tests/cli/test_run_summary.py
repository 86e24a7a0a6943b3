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
    path.write_text(json.dumps({"episodes": 100, "env": "static", "valleys": valleys, "success": success}))
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
        "Success rate: 50.0 % (95 % CI 40.0–60.0 %, 100 tasks)",
        "Worlds:  1 of its training valleys (seed 0), env=static, without exploration noise",
        "Policy:  TD3, prize, trained for 600 episodes, 81,234 steps and 7.2 minutes",
        f"Where:   {trained} (uavrl-evaluate run={trained} suite=all evaluates it in every scenario, "
        "uavrl-export keeps the policy on its own)",
        f"Look:    open {trained}/replay.html in a browser",
    ]


@pytest.mark.parametrize(
    ("valleys", "said"),
    [
        ([100, 101], "2 unseen valleys (seeds 100–101)"),
        ([100, 1], "2 valleys, 1 of them from its training (seeds 1, 100)"),
    ],
)
def test_so_is_whether_it_was_trained_in_the_valleys(
    valleys: list[int], said: str, trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluated(trained, "evaluation.json", 0.5, when=1_000_000_000, valleys=valleys)
    assert in_process(main, str(trained)) == 0
    assert f"Worlds:  {said}, env=static" in capsys.readouterr().out


def test_a_run_that_has_not_come_so_far_is_told_in_one_sentence(tmp_path: Path, refused: Callable[..., str]) -> None:
    missing = f"uavrl: {tmp_path} holds no evaluation: run uavrl-evaluate run={tmp_path} first."
    assert refused(main, str(tmp_path)) == missing
    evaluated(tmp_path, "evaluation.json", 0.5, when=1_000_000_000)
    assert "summary.json" in refused(main, str(tmp_path))
