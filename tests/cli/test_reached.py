"""What a training that was evaluated and drawn says at its end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path


def evaluated(folder: Path, name: str, rate: float, when: float) -> None:
    path = folder / name
    path.write_text(json.dumps({"success": {"rate": rate, "low": rate - 0.1, "high": rate + 0.1}}))
    os.utime(path, (when, when))


def reached(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "uavrl.cli.reached", str(folder)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_newest_evaluation_is_told(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text(json.dumps({"episodes": 600, "steps": 81_234, "minutes": 7.25}))
    evaluated(tmp_path, "evaluation.json", 0.5, when=2_000_000_000)
    evaluated(tmp_path, "evaluation_env=dynamic.json", 0.4, when=1_000_000_000)
    lines = reached(tmp_path).stdout.splitlines()
    assert lines[0].startswith("Reached: 50 % of fixed tasks") and "(40-60 %)" in lines[0]
    assert str(tmp_path) in lines[1] and f"{tmp_path}/replay.html" in lines[2]


def test_a_run_that_has_not_come_so_far_is_told_in_one_sentence(tmp_path: Path) -> None:
    done = reached(tmp_path)
    assert done.returncode == 1 and done.stderr.splitlines() == [
        f"uavrl: {tmp_path} holds no evaluation: run uavrl-evaluate run={tmp_path} first."
    ]
    evaluated(tmp_path, "evaluation.json", 0.5, when=1_000_000_000)
    done = reached(tmp_path)
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1 and "summary.json" in done.stderr
