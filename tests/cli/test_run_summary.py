"""What a training that was evaluated and drawn says at its end."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from uavrl.cli.run_summary import main


def evaluated(folder: Path, name: str, rate: float, when: float) -> None:
    path = folder / name
    path.write_text(json.dumps({"success": {"rate": rate, "low": rate - 0.1, "high": rate + 0.1}}))
    os.utime(path, (when, when))


def test_the_newest_evaluation_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "summary.json").write_text(json.dumps({"episodes": 600, "steps": 81_234, "minutes": 7.25}))
    evaluated(tmp_path, "evaluation.json", 0.5, when=2_000_000_000)
    evaluated(tmp_path, "evaluation_env=dynamic.json", 0.4, when=1_000_000_000)
    assert in_process(main, str(tmp_path)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("Reached: 50 % of fixed tasks") and "(40-60 %)" in lines[0]
    assert str(tmp_path) in lines[1] and f"{tmp_path}/replay.html" in lines[2]


def test_a_run_that_has_not_come_so_far_is_told_in_one_sentence(tmp_path: Path, refused: Callable[..., str]) -> None:
    missing = f"uavrl: {tmp_path} holds no evaluation: run uavrl-evaluate run={tmp_path} first."
    assert refused(main, str(tmp_path)) == missing
    evaluated(tmp_path, "evaluation.json", 0.5, when=1_000_000_000)
    assert "summary.json" in refused(main, str(tmp_path))
