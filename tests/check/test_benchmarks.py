"""The benchmarks run and write what the documentation quotes; tests/test_benchmarks.py has what they count."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

ROOT = Path(__file__).resolve().parents[2]


def written_by(benchmark: str, folder: Path, *arguments: str) -> dict[str, Any]:
    output = folder / "numbers.json"
    command = [sys.executable, str(ROOT / "benchmarks" / benchmark), *arguments, "--json", str(output)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(output.read_text())


def test_a_wrong_use_ends_in_one_sentence(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "benchmarks" / "differences.py"), "none.json:a", "--less", "none.json:b"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert result.returncode == 1
    assert result.stderr.startswith("uavrl: Expected FILE.json:WORLD") and result.stderr.count("\n") == 1


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
def test_the_training_benchmark_writes_its_ratios(tmp_path: Path) -> None:
    few = ["--repeats", "1", "--steps", "40", "--warm-up", "40", "--skip-async"]
    numbers = written_by("train.py", tmp_path, *few)
    speeds = {name: row["steps_per_second"] for name, row in numbers["rows"].items()}
    assert numbers["steps_per_second"] == speeds[numbers["row"]] == speeds["uavrl"]
    assert numbers["vs_sb3"] == pytest.approx(speeds["uavrl"] / speeds["Stable-Baselines3"])
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


@pytest.mark.slow
def test_the_walkers_benchmark_writes_its_shares(tmp_path: Path) -> None:
    numbers = written_by("walker.py", tmp_path, "trainer.execution=captured", "env.max_steps=100", "--steps", "50")
    assert sum(numbers["shares"].values()) == pytest.approx(1)
    assert {"updates", "environment"} < set(numbers["shares"])
    assert numbers["steps"] >= 50 and numbers["steps_per_second"] > 0


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


def test_reactions_are_told_of_a_policy_that_always_flies_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """One whose action is the same with and without planes changes nothing; the rows tell passes within reach."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import reactions
    from common import experiment
    from tensordict import TensorDict

    seen = []

    def flies_on(state: TensorDict) -> TensorDict:
        seen.append(state["observation"].clone())
        return state.set("action", torch.tensor([1.0, 0.0, 0.0, 0.3]).expand(*state.batch_size, 4))

    rows = reactions.reactions(experiment("env=dynamic", "env.world.planes=6", "env.world.obstacles=8"), flies_on, 45)
    assert len(rows) > 0 and rows.shape[1] == 8
    assert np.abs(rows[:, 4:]).max() == 0
    assert (np.hypot(rows[:, 1], rows[:, 2]) < 1.6).all() and (rows[:, 0] >= 0).all()
    for shown, hidden in zip(seen[::2], seen[1::2], strict=True):  # without planes nothing new is seen, at any frame
        rest = torch.arange(105) % 35 >= 32
        assert torch.equal(shown[:, rest], hidden[:, rest])
    first_shown, first_hidden = seen[0], seen[1]
    assert first_shown[:, :70].abs().sum() == 0 == first_hidden[:, :70].abs().sum()  # zeros before the first frame


def test_networks_tell_what_their_input_tells_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Asked of rows that they were not taught with: all right with the answer among the numbers, half without."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import foresight

    rng = np.random.default_rng(0)
    x = rng.normal(size=(800, 2, 3))
    label, taught = x[:, 1, 2] > 0, np.arange(800) < 600
    assert ((foresight.answers(x, label, taught) > 0) == label)[~taught].mean() > 0.95
    x[:, 1, 2] = 0
    assert 0.35 < ((foresight.answers(x, label, taught) > 0) == label)[~taught].mean() < 0.65
