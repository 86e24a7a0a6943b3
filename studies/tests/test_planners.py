"""Planners that policies are compared with: tuned, told beside the packaged policy, and one that knows the map."""

from __future__ import annotations

import importlib
import json
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from tests.helpers.flights import small_recording
from uavrl.envs.tasks import FlightMap, FreeSpace
from uavrl.errors import UavrlError
from uavrl.evaluation.recording import save_recording
from uavrl.planners.mppi import MPPIWeights

Said = Callable[..., str]


def test_a_rivals_settings_are_drawn_and_the_better_ones_fly_on(
    said: Said, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A world in which the third setting arrives: of eight two are left, which fly four times as many tasks."""
    import tune_rivals

    settings, flown = tune_rivals.drawn(tune_rivals.RIVALS["mppi"], 8), list[int]()

    def fly(env: Any, policy: Any, tasks: int) -> list[Any]:
        flown.append(tasks)
        outcome = "arrived" if policy.costs.spread == settings[2]["spread"] else "collided"
        return [SimpleNamespace(outcome=outcome, steps=100)] * tasks

    monkeypatch.setattr(tune_rivals, "rollout_episodes", fly)
    monkeypatch.setattr(tune_rivals, "make_env", lambda *parts, **more: SimpleNamespace(set_seed=lambda seed: None))
    arguments = f"tune_rivals.py mppi --settings 8 --tasks 4 --json {tmp_path}/t.json"
    monkeypatch.setattr(sys, "argv", arguments.split())
    tune_rivals.main()
    rounds = json.loads((tmp_path / "t.json").read_text())["rounds"]
    assert [len(found) for found in rounds] == [8, 2] and flown == [4] * 8 + [16] * 2
    assert rounds[1][0]["setting"] == settings[2] and settings[0] == asdict(MPPIWeights()), "the present ones take part"


def test_rivals_are_told_beside_the_packaged_policy(
    said: Said, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import rivals

    of_best, commands = json.loads(rivals.BEST.read_text()), list[str]()

    def run(command: list[str], **more: Any) -> subprocess.CompletedProcess[str]:
        commands.append(" ".join(command[4:]))
        (tmp_path / "mppi").mkdir(exist_ok=True)
        row = command[5].removeprefix("suite=[").removesuffix("]")
        told = {**of_best[row], "outcomes": "C" * 500, "flights": []}
        (tmp_path / f"mppi/{row}.json").write_text(json.dumps(told))
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(rivals.subprocess, "run", run)
    monkeypatch.setattr(rivals, "milliseconds", lambda name, vehicles: float(vehicles))
    monkeypatch.setattr(
        sys, "argv", f"rivals.py {tmp_path} --rivals mppi --rows dense real --json {tmp_path}/t.json".split()
    )
    told: list[str] = []
    monkeypatch.setattr("builtins.print", lambda *words, **more: told.append(str(words[0])))
    rivals.main()
    assert told[-1].startswith("| `policy=mppi` | 0.0 (0.0–0.8) | -91.2 (") and "| 1.0, 16.0 |" in told[-1]
    asked = sorted(
        f"policy=mppi suite=[{name}] output={tmp_path}/mppi progress=false episodes=500" for name in ("dense", "real")
    )
    assert sorted(commands) == asked
    kept = json.loads((tmp_path / "t.json").read_text())["mppi"]
    assert set(kept) == {"dense", "real"} and "flights" not in kept["real"]
    assert rivals.lines_of(importlib.import_module("uavrl.planners.potential_field")) in range(30, 60)


def test_a_row_that_fails_is_named_in_a_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import rivals

    failed = subprocess.CompletedProcess([], 1)
    monkeypatch.setattr(rivals.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(UavrlError, match=r"mppi, dense: uavrl evaluate has ended with 1, .* flies what is missing"):
        rivals.fly("mppi", "dense", tmp_path, 2)


def test_who_knows_the_map_arrives_and_is_not_sooner_than_straight_on(said: Said, tmp_path: Path) -> None:
    told = said("known_map", "--rows", "static", "--tasks", 2, "--json", tmp_path / "found.json")
    found = json.loads((tmp_path / "found.json").read_text())["static"]
    assert found["outcomes"] == "SS" and found["straight"] <= found["steps"] <= found["longest"] < 300
    assert "| static | 100.0 (34.2–100.0) |" in told


def test_the_way_to_the_goal_leads_around_and_is_flown_as_fast_as_it_is_wide(said: Said) -> None:
    known_map = importlib.import_module("known_map")
    x, y, z = np.arange(0.0, 4.0, 0.25), np.arange(0.0, 3.0, 0.25), np.array([3.0, 3.5, 4.0])
    wall = (x[:, None, None] == 2.0) & (y[None, :, None] < 2.0) & (z > 0)
    space = FreeSpace(x, y, z, np.where(wall, 0.0, 0.6))
    ways = known_map.Ways(FlightMap(space, ~wall, np.zeros((0, 2))))
    following = ways.to(np.array([3.5, 0.5, 3.5]), 0.5)
    way, _ = ways.towards(np.array([1.5, 0.5, 3.5]), following)
    assert way[1] > 0.5 and np.abs(way[0]) < 1.0  # first along the wall
    beside, wide = ways.towards(np.array([3.0, 1.5, 3.5]), following)
    assert beside[1] < -0.5 and wide == pytest.approx(0.6)
    far = np.array([3.0, 0.0, 0.0])
    fast = known_map.command(far, 0.6, np.array([2 * 2**0.5, 0, 0]), math.pi / 4)
    assert fast == pytest.approx([2.0, -2.0, 0.0, 0.0])
    slow = known_map.command(far, 0.35, np.zeros(3), math.pi / 4)
    assert np.hypot(*slow[:2]) == pytest.approx(2 * known_map.SLOWEST) and slow[3] == pytest.approx(0.0)


def test_the_first_failure_of_each_recording_is_drawn(
    said: Said, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failing = small_recording(tasks=(1, 5))
    ends = ("arrived", "collided")
    flights = [
        replace(f, summary=replace(f.summary, outcome=end)) for f, end in zip(failing.flights, ends, strict=True)
    ]
    save_recording(replace(failing, flights=tuple(flights)), tmp_path / "mine.npz")
    told = said("failures", tmp_path / "mine.npz", "--output", tmp_path / "failures.png")
    assert "mine: success 1, collision 1" in told
    height, width, _ = imread(tmp_path / "failures.png").shape
    assert 1.0 < height / width < 1.3, "one picture, of the one failure"
    save_recording(replace(failing, flights=tuple(flights[:1])), tmp_path / "good.npz")
    with pytest.raises(SystemExit):
        said("failures", tmp_path / "good.npz", "--output", tmp_path / "none.png")
    assert "Every flight of these recordings succeeds" in capsys.readouterr().err
    assert not (tmp_path / "none.png").exists()
