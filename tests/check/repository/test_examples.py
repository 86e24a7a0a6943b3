"""Examples do what the documentation says of them."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.envs import TransformedEnv

from uavrl.envs import WorldConfig
from uavrl.evaluation.policies import PACKAGED
from uavrl.runs.episodes import wilson

ROOT = Path(__file__).parents[3]
EXAMPLES, FIGURES = ROOT / "examples", ROOT / "docs/figures"


def said(script: Path, *arguments: object) -> str:
    """What a script prints, in a process of its own."""
    command = [sys.executable, "-W", "error::FutureWarning", script, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_backward_reward_is_used_outside_the_valley() -> None:
    assert "arrived" in said(EXAMPLES / "backward_reward.py", 600)


def test_one_file_trains_td3_with_torchrls_collector_and_buffer(monkeypatch: pytest.MonkeyPatch) -> None:
    example = runpy.run_path(str(EXAMPLES / "td3_in_150_lines.py"))
    train = example["train"]
    monkeypatch.setitem(train.__globals__, "LEARNING_STARTS", 64)
    world = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=5.0)
    env = example["make_env"](uavs=2, seed=0, world=world)
    flown: list[Tensor] = []
    monkeypatch.setitem(train.__globals__, "print", lambda *_, **__: None)
    episodes = train.__globals__["episodes"]

    def watched(env: TransformedEnv, actor: TensorDictModule, device: str) -> Iterator[TensorDictBase]:
        for episode in episodes(env, actor, device):
            flown.append(actor.get_submodule("module.net.0").weight.detach().clone())
            yield episode

    monkeypatch.setitem(train.__globals__, "episodes", watched)
    loss = train(env, 1000)  # no episode has more than 300
    trained = loss.actor_network_params["module", "net", "0", "weight"]
    assert len(flown) > 2 and not torch.equal(flown[0], flown[-1]), "the policy that flies is the one that learns"
    assert not torch.equal(trained, flown[0])
    env.close()


def test_altitudes_are_drawn_from_the_packaged_evaluations(tmp_path: Path) -> None:
    place = f"{PACKAGED / 'best' / 'suite.json'}:static"
    printed = said(FIGURES / "altitudes.py", place, "--output", tmp_path / "altitudes.png")
    assert printed.startswith("best, static ")
    low, middle, high = (float(x) for x in printed.split("%: ")[1].split(" m")[0].split(" / "))
    assert 0 < low < middle < high < 5
    assert (tmp_path / "altitudes.png").stat().st_size > 5_000


def test_a_scan_and_its_cells_are_drawn(tmp_path: Path) -> None:
    drawing = runpy.run_path(str(FIGURES / "reduction.py"))
    cells = np.zeros(72, np.float32)
    cells[[1, 3 * 6 + 2, 3 * 12]] = 1.0  # ahead in the middle, to the left above, behind below
    image = drawing["picture_of"](cells)
    assert np.argwhere(np.isfinite(image)).tolist() == [[0, 0], [0, 24], [1, 12], [2, 6]] and image[1, 12] == 3.0
    printed = said(FIGURES / "reduction.py", "--output", tmp_path / "reduction.png")
    assert "of 72 cells" in printed and int(printed.split()[0]) > 1000
    assert (tmp_path / "reduction.png").stat().st_size > 20_000


def test_success_and_time_are_drawn_against_the_limit_of_speed(tmp_path: Path) -> None:
    file, picture = tmp_path / "speed.json", tmp_path / "speed.png"
    flights = [{"flown": 20.0, "steps": 100}, {"flown": 10.0, "steps": 50}]
    evaluation = {"episodes": 2, "success": wilson(1, 2), "collision": wilson(1, 2), "time_out": wilson(0, 2)}
    evaluation |= {"outcomes": "SC", "steps_per_arrival": 100.0, "flights": flights}
    (tmp_path / "one.json").write_text(json.dumps(evaluation))
    for name, limit in (("fast", "6"), ("fast", "2"), ("slow", "2")):
        said(FIGURES / "speed.py", file, "--add", name, limit, tmp_path / "one.json")
    assert json.loads(file.read_text())["slow"]["2"]["mean_speed"] == 2.0
    assert said(FIGURES / "speed.py", file, "--table").splitlines() == [
        "| success in % (95 % CI); time to the goal in s | 2 m/s | 6 m/s |",
        "|---|---|---|",
        "| fast | 50.0 (9.5–90.5); 10.0 | 50.0 (9.5–90.5); 10.0 |",
        "| slow | 50.0 (9.5–90.5); 10.0 | – |",
    ]
    said(FIGURES / "speed.py", file, "--output", picture)
    assert picture.stat().st_size > 5_000


def test_success_with_each_sensor_is_drawn_from_the_row_with_most_tasks(tmp_path: Path) -> None:
    drawing = runpy.run_path(str(FIGURES / "sensors.py"))
    row = {
        "policy": "best",
        "world": "rooms",
        "sensor": "vlp16",
        "guards": "all",
        "episodes": 100,
        "success": {"rate": 0.9},
    }
    others = [row | {"episodes": 50, "success": {"rate": 0.1}}, row | {"policy": "vfh"}, row | {"world": "mine"}]
    cells = drawing["grid"]([row, *others])
    assert cells[0].tolist()[-1] == 90.0 and np.isfinite(cells).sum() == 1
    file = tmp_path / "sensors.json"
    file.write_text(json.dumps([row]))
    said(FIGURES / "sensors.py", file, "--output", tmp_path / "sensors.png")
    assert (tmp_path / "sensors.png").stat().st_size > 2_000


def test_success_in_each_world_is_drawn_from_what_the_suite_wrote(tmp_path: Path) -> None:
    suites = ROOT / "docs/data/suite"
    picture = tmp_path / "worlds.png"
    said(FIGURES / "scenarios.py", f"a rule={suites / 'vfh_turning.json'}", suites / "best.json", "--output", picture)
    assert picture.stat().st_size > 5_000
    few = tmp_path / "few.json"
    row = json.loads((suites / "best.json").read_text())["static"]
    few.write_text(json.dumps({"few": {**row, "episodes": 20, "success": {"rate": 0.5, "low": 0.3, "high": 0.7}}}))
    worlds = ["--table", "--worlds", "static", "few"]
    printed = said(FIGURES / "scenarios.py", f"one={suites / 'best.json'}", f"one={few}", f"other={few}", *worlds)
    assert printed.splitlines()[0] == "| success in % | `static` | `few` |"
    assert printed.splitlines()[2:] == [
        "| one | 98.8 (97.4–99.4) | 50.0\\* (30.0–70.0) |",
        "| other | – | 50.0\\* (30.0–70.0) |",
    ]
    evaluation = tmp_path / "evaluation.json"
    evaluation.write_text(json.dumps(json.loads((suites / "best.json").read_text())["static"]))
    drawing = [sys.executable, FIGURES / "scenarios.py"]
    for wrong, message in (
        ([evaluation], "Expected worlds with a success each in"),
        ([suites / "best.json", "--worlds", "dence"], "Expected worlds that a file tells of, got dence"),
    ):
        done = subprocess.run([*drawing, *wrong], capture_output=True, text=True, timeout=600)
        assert message in done.stderr
