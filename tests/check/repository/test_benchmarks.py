"""The benchmarks run and write what the documentation quotes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]


def written_by(benchmark: str, folder: Path, *arguments: str) -> dict[str, Any]:
    output = folder / "numbers.json"
    command = [sys.executable, str(ROOT / "benchmarks" / benchmark), *arguments, "--json", str(output)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(output.read_text())


@pytest.mark.slow
def test_the_lidar_benchmark_writes_its_ratios(tmp_path: Path) -> None:
    numbers = written_by("lidar.py", tmp_path, "--num", "1", "--num-pybullet", "1", "--repeats", "1")
    rows = {name: row["ms_per_scan"] for name, row in numbers["rows"].items()}
    ours = rows["scan + reduction, cut"]
    assert numbers["vs_pybullet"] == pytest.approx(rows["PyBullet rayTestBatch, uncut"] / ours)
    assert numbers["vs_bare_embree"] == pytest.approx(ours / rows["bare Embree, cut"])
    assert numbers["vs_pybullet"] > 1
    assert numbers["vs_bare_embree"] > 0.5
    assert (numbers["num"], numbers["rays_per_scan"], numbers["threads"]) == (1, 28_928, 1)


@pytest.mark.slow
def test_the_environment_benchmark_writes_its_profile(tmp_path: Path) -> None:
    numbers = written_by("env.py", tmp_path, "--uavs", "2", "--repeats", "1", "--steps", "32")
    bare = numbers["rows"]["bare PyBullet physics"] + numbers["rows"]["bare Embree rays"]
    assert numbers["vs_bare"] == pytest.approx(numbers["ms_per_uav_step"] / bare)
    assert min(numbers["profile"].values()) > 0
    assert max(numbers["profile"], key=numbers["profile"].get).startswith(("rays", "physics: control", "reduction"))
    assert (numbers["uavs"], numbers["rays_per_scan"], numbers["threads"]) == (2, 28_928, 1)


@pytest.mark.slow
def test_the_motion_benchmark_writes_its_rows(tmp_path: Path) -> None:
    numbers = written_by("motion.py", tmp_path, "--uavs", "2", "--repeats", "1", "--steps", "16")
    plain, *others = numbers["ms_per_uav_step"].values()
    assert len(others) == 6 and 0 < plain < min(others)


@pytest.mark.slow
def test_the_training_benchmark_writes_its_ratios(tmp_path: Path) -> None:
    few = ["--repeats", "1", "--steps", "40", "--warm-up", "40", "--skip-async"]
    numbers = written_by("train.py", tmp_path, *few)
    speeds = {name: row["steps_per_second"] for name, row in numbers["rows"].items()}
    assert numbers["steps_per_second"] == speeds[numbers["row"]] == speeds["uavrl"]
    assert numbers["vs_sb3"] == pytest.approx(speeds["uavrl"] / speeds["Stable-Baselines3"])
    assert numbers["vs_sb3_eight"] == pytest.approx(speeds["uavrl"] / speeds["Stable-Baselines3, 8 UAVs in one world"])
    assert numbers["vs_sb3_pybullet"] == pytest.approx(speeds["uavrl"] / speeds["Stable-Baselines3 + PyBullet's rays"])
    assert numbers["vs_sb3_pybullet"] > 1
    assert all(100 < row["peak_rss_mib"] < 10_000 for row in numbers["rows"].values())


@pytest.mark.slow
def test_the_buffer_benchmark_writes_its_ratios(tmp_path: Path) -> None:
    numbers = written_by("buffer.py", tmp_path, "--transitions", "50000", "--repeats", "3")
    rows = numbers["rows"]
    ours, torchrl = rows["uavrl"], rows["TorchRL's LazyTensorStorage"]
    assert numbers["memory_vs_torchrl"] == pytest.approx(ours["bytes_per_transition"] / torchrl["bytes_per_transition"])
    assert numbers["memory_vs_torchrl"] < 0.35
    assert numbers["memory_vs_sb3"] < 0.35
    assert numbers["sample_vs_torchrl"] == pytest.approx(ours["sample_ms"] / torchrl["sample_ms"])


def test_the_audit_counts_how_blind_flights_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a valley without obstacles all fly straight at the goal and arrive; one that dives first hits the ground."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import loopholes

    from uavrl.envs import NavigationEnv, WorldConfig

    env = NavigationEnv(2, world=WorldConfig(obstacles=0), blind=True)
    names = set(loopholes.controllers(env.world))
    assert {"straight at 3.5 m", "straight at 4.5 m", "first to 0.5 m, then straight"} <= names
    assert {"along the wall at -x, 1 m from it", "along the wall at +y, 3 m from it", "over two random legs"} <= names
    for name in ("straight at 3.5 m", "first to 4.0 m, then straight"):
        row = loopholes.arrivals(env, loopholes.controllers(env.world)[name], 2, 77777)
        assert row["arrived"] == 2 and row["success"]["rate"] == 1.0
    row = loopholes.arrivals(env, loopholes.level_first(-3.0), 2, 77777)
    assert row["collided"] == 2 and row["success"]["rate"] == 0.0
    env.close()
    kept = ["straight at 3.5 m", "along the wall at +x, 2 m from it"]
    every = loopholes.controllers
    monkeypatch.setattr(loopholes, "controllers", lambda world: {name: every(world)[name] for name in kept})
    output = tmp_path / "audit.json"
    monkeypatch.setattr("sys.argv", ["loopholes.py", "env.max_steps=40", "--tasks", "2", "--json", str(output)])
    loopholes.main()
    audit = json.loads(output.read_text())
    assert list(audit["rows"]) == kept
    assert (audit["tasks"], audit["seed"], audit["overrides"]) == (2, 77777, ["env.max_steps=40"])
    for row in audit["rows"].values():
        assert sum(row.get(end, 0) for end in ("arrived", "collided", "timed_out")) == 2
