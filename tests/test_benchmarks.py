"""The benchmarks run and write what the documentation quotes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_the_lidar_benchmark_writes_its_ratios(tmp_path: Path) -> None:
    output = tmp_path / "lidar.json"
    arguments = ["--num", "1", "--num-pybullet", "1", "--repeats", "1", "--json", str(output)]
    command = [sys.executable, str(ROOT / "benchmarks/lidar.py"), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert result.returncode == 0, result.stderr
    numbers = json.loads(output.read_text())
    rows = {name: row["ms_per_scan"] for name, row in numbers["rows"].items()}
    ours = rows["scan + reduction, cut"]
    assert numbers["vs_pybullet"] == pytest.approx(rows["PyBullet rayTestBatch, uncut"] / ours)
    assert numbers["vs_bare_embree"] == pytest.approx(ours / rows["bare Embree, cut"])
    assert numbers["vs_pybullet"] > 1
    assert numbers["vs_bare_embree"] > 0.5
    assert (numbers["num"], numbers["rays_per_scan"], numbers["threads"]) == (1, 28_928, 1)
