"""The suite flies its scenarios once each, and tells them in one table."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.commands import in_process
from tests.helpers.configs import composed
from tests.helpers.folders import evaluation
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli.suite import in_worlds_of
from uavrl.config import EvaluateConfig, validate
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import PACKAGED
from uavrl.evaluation.suite import scenarios
from uavrl_onboard.values import to_plain

LITTLE = ["policy=straight", "suite=[static,dense]", "episodes=2", "seed=7"]

REAL = {
    "real_vehicle": {"mass", "inertia", "thrust", "motor_time_constant", "drag"},
    "real_delay": {"action_delay", "scan_delay"},
    "real_sensor": {
        "mount_yaw",
        "mount_tilt",
        "range_noise",
        "dropout",
        "blind_sector",
        "altitude_bias",
        "heading_bias",
    },
    "real_wind": {"wind", "gust_intensity"},
}
REAL["real"] = set().union(*REAL.values())


@pytest.mark.parametrize("name", scenarios("all"))
def test_every_scenario_is_an_evaluation(name: str) -> None:
    row = in_worlds_of(scenarios([name])[name])
    settings = validate(composed("evaluate", "policy=straight", *row), EvaluateConfig)
    world, lidar = settings.env.world, settings.perception.lidar
    valleys = len(world.seeds if settings.valleys == "training" else settings.valleys)
    seen = (world.obstacles, world.planes, valleys, settings.env.aerodynamics.wind, lidar.dropout)
    expected = {
        "static": (45, 0, 1, (0.0, 0.0, 0.0), 0.0),
        "dynamic": (45, 10, 1, (0.0, 0.0, 0.0), 0.0),
        **dict.fromkeys(("held_out", "fast4", "fast6"), (45, 0, 10, (0.0, 0.0, 0.0), 0.0)),
        "dense": (90, 0, 1, (0.0, 0.0, 0.0), 0.0),
        "denser": (135, 0, 1, (0.0, 0.0, 0.0), 0.0),
        "traps": (20, 0, 10, (0.0, 0.0, 0.0), 0.0),
        "busy": (45, 20, 1, (0.0, 0.0, 0.0), 0.0),
        "windy": (45, 0, 1, (3.0, 0.0, 0.0), 0.0),
        "sensor": (45, 0, 1, (0.0, 0.0, 0.0), 0.1),
        **dict.fromkeys(REAL, (45, 0, 10, (0.0, 0.0, 0.0), 0.0)),
    }[name]
    assert (*seen[:3], tuple(seen[3]), seen[4]) == expected
    assert settings.env.max_speed == {"fast4": 4.0, "fast6": 6.0}.get(name, 2.0)


@pytest.mark.parametrize("name", scenarios("all"))
def test_a_scenario_randomizes_what_it_is_called_after_and_real_everything(name: str) -> None:
    settings = validate(composed("evaluate", "policy=straight", *scenarios([name])[name]), EvaluateConfig)
    drawn = {key for key, value in to_plain(settings.env.randomize).items() if value is not None}
    assert drawn == REAL.get(name, set())
    assert settings.env.randomize.is_on == bool(drawn)


def test_unknown_scenarios_are_refused_with_the_nearest() -> None:
    with pytest.raises(UavrlError, match="got 'dens': did you mean dense"):
        scenarios(["static", "dens"])


@pytest.mark.slow
def test_what_is_flown_is_kept_and_what_is_damaged_or_of_other_tasks_is_flown_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "it's a = suite"
    quoted = str(folder).replace("'", "\\'")
    command = [*LITTLE, f"output='{quoted}'"]
    assert in_process(evaluate_command.main, *command) == 0
    shown = capsys.readouterr()
    assert "dense " in shown.out and "4/4 tasks | " in shown.err
    table = json.loads((folder / "suite.json").read_text())
    assert list(table) == ["static", "dense"]
    assert len(table["dense"]["outcomes"]) == 2 and {"versions", "processor"} < table["dense"].keys()
    assert table["dense"]["overrides"] == ["policy=straight", "seed=7", "env=static", "env.world.obstacles=90"]
    (folder / "dense.json").write_text("{")
    old = 1_000_000_000
    os.utime(folder / "static.json", (old, old))
    assert in_process(evaluate_command.main, *command) == 0
    assert (folder / "static.json").stat().st_mtime == old
    assert json.loads((folder / "dense.json").read_text())["episodes"] == 2


def test_a_file_from_before_there_were_outcomes_is_taken_and_its_row_has_them(tmp_path: Path) -> None:
    flights = [{"task": 0, "outcome": "arrived"}, {"task": 1, "outcome": "collided"}]
    told = {"overrides": ["policy=straight", "seed=7", "env=static"], "seed": 7, "flights": flights}
    older = evaluation(tmp_path, 1, 2, "static.json", **told).read_text()
    assert in_process(evaluate_command.main, *LITTLE, "suite=[static]", f"output={tmp_path}") == 0
    assert (tmp_path / "static.json").read_text() == older
    row = json.loads((tmp_path / "suite.json").read_text())["static"]
    assert row["outcomes"] == "SC" and "flights" not in row and "versions" not in row


def test_the_table_of_a_folder_keeps_the_policys_rows_of_earlier_commands(tmp_path: Path) -> None:
    """Of another policy, or other tasks, it takes none."""
    flights = [{"task": 0, "outcome": "arrived"}, {"task": 1, "outcome": "collided"}]
    for name, policy in {"static": "straight", "dense": "straight", "held_out": "vfh"}.items():
        told = {"overrides": [f"policy={policy}", "seed=7", *scenarios([name])[name]], "seed": 7, "flights": flights}
        evaluation(tmp_path, 1, 2, f"{name}.json", **told)
    for name in ("dense", "static"):
        assert in_process(evaluate_command.main, *LITTLE, f"suite=[{name}]", f"output={tmp_path}") == 0
    rows = json.loads((tmp_path / "suite.json").read_text())
    assert list(rows) == ["static", "dense"] and rows["dense"]["outcomes"] == "SC"


def test_the_table_has_rows_that_another_command_wrote_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def row(name: str) -> dict[str, Any]:
        told = {"overrides": ["policy=straight", "seed=7", *scenarios([name])[name]], "seed": 7, "outcomes": "SC"}
        found: dict[str, Any] = json.loads(evaluation(tmp_path, 1, 2, f"{name}.json", **told).read_text())
        return found

    def evaluated(wanted: dict[str, Any], _: object) -> dict[str, Any]:
        row("dense")
        return {name: row(name) for name in wanted}

    monkeypatch.setattr("uavrl.cli.suite._evaluated", evaluated)
    (tmp_path / "traps.json").mkdir()  # which no command could read
    assert in_process(evaluate_command.main, *LITTLE, "suite=[static]", f"output={tmp_path}") == 0
    assert list(json.loads((tmp_path / "suite.json").read_text())) == ["static", "dense"]


def test_another_runs_results_in_the_same_folder_are_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which run it is stands in no override."""
    policy = {"run": str(PACKAGED / "best"), "seed": 7, "outcomes": "SC"}
    for name in ("static", "dense"):
        evaluation(tmp_path, 1, 2, f"{name}.json", overrides=["seed=7", *scenarios([name])[name]], **policy)
    evaluated: list[str] = []

    def evaluate(wanted: dict[str, Any], _: object) -> dict[str, Any]:
        evaluated.extend(wanted)
        return {name: json.loads((tmp_path / f"{name}.json").read_text()) for name in wanted}

    monkeypatch.setattr("uavrl.cli.suite._evaluated", evaluate)
    for run, anew in (("best", []), ("best_dynamic", ["static"])):
        what = [f"run={PACKAGED / run}", "suite=[static]", *LITTLE[2:], f"output={tmp_path}"]
        assert in_process(evaluate_command.main, *what) == 0
        assert evaluated == anew
        assert list(json.loads((tmp_path / "suite.json").read_text())) == (["static"] if anew else ["static", "dense"])


def test_a_row_among_planes_that_other_processes_have_flown_is_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each process has planes of its own; without planes all fly the same."""
    for name, planes in (("static", 0), ("dynamic", 10)):
        told = {"overrides": ["policy=straight", "seed=7", *scenarios([name])[name]], "seed": 7, "outcomes": "SC"}
        evaluation(tmp_path, 1, 2, f"{name}.json", planes=planes, num_uavs=2, **told)
    flown: list[list[str]] = []

    def evaluate(wanted: dict[str, Any], _: object) -> dict[str, Any]:
        flown.append(list(wanted))
        return {name: json.loads((tmp_path / f"{name}.json").read_text()) for name in wanted}

    monkeypatch.setattr("uavrl.cli.suite._evaluated", evaluate)
    what = ["policy=straight", "suite=[static,dynamic]", *LITTLE[2:], f"output={tmp_path}"]
    for processes in ("1", "2", "null"):
        assert in_process(evaluate_command.main, *what, f"processes={processes}") == 0
    assert flown == [["dynamic"]]


@pytest.mark.parametrize("more", ["env=dynamic", "valleys=[3]", "env.world.obstacles=5", "randomize=wind"])
def test_the_suite_chooses_the_worlds(tmp_path: Path, capsys: pytest.CaptureFixture[str], more: str) -> None:
    assert in_process(evaluate_command.main, *LITTLE, more, f"output={tmp_path}") == 1
    assert f"'{more}' contradicts it" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
