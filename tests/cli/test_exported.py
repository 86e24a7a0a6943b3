"""``policy=FOLDER``: what ``uavrl-export`` wrote flies in the simulator by numpy and ONNX Runtime."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.commands import VALLEY, in_process
from tests.helpers.exported import edit_contract, exported
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import replay as replay_command
from uavrl.cli.suite import _changed
from uavrl.config import EvaluateConfig, compose, validate
from uavrl.evaluation import environment
from uavrl.evaluation.policy_setup import choose
from uavrl.evaluation.recording import load_recording
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.guards.shield import Shield

Refused = Callable[..., str]
SHORT = [*VALLEY, "episodes=3", "num_uavs=2", "env.max_steps=8", "progress=false"]  # a vehicle begins a second episode
CELLS = ("algo=sac", "perception=range_image", "perception.last_action=true", "perception.radius=6")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of another reduction and radius than the default's, and with its sensor elsewhere."""
    place = "env.airframe.lidar_position=[0,0,0.2]"
    return exported(tmp_path_factory.mktemp("exported"), "algo.hidden=[16]", *CELLS, place)


def evaluation(output: Path, *arguments: str) -> dict[str, Any]:
    assert in_process(evaluate_command.main, *arguments, *SHORT, f"output={output}") == 0
    return json.loads(output.read_text())


@pytest.mark.parametrize("guards", ["none", "shield"])
def test_it_flies_as_its_weights_do(guards: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind a shield, too, where its last action is not what it gave."""
    monkeypatch.setattr(Shield, "bend", lambda _, asked, *__: np.asarray(asked) / 2)
    ours = evaluation(tmp_path / "policy.json", f"policy={folder}", f"guards={guards}")
    theirs = evaluation(tmp_path / "run.json", f"run={folder}", f"guards={guards}")
    assert ours["policy"] == str(folder) and ours["outcomes"] == theirs["outcomes"]
    if guards == "shield":
        assert ours["guard_share"] > 0.9, "the shield halves all velocities"
    for flown, expected in zip(ours["flights"], theirs["flights"], strict=True):
        assert (flown["task"], flown["outcome"], flown["steps"]) == tuple(
            expected[k] for k in ("task", "outcome", "steps")
        )
        for key in ("flown", "clearance", "action_change"):
            assert flown[key] == pytest.approx(expected[key], abs=1e-3)


def test_it_can_be_replayed_with_what_it_sees(folder: Path, tmp_path: Path) -> None:
    data = tmp_path / "flights.npz"
    arguments = [*VALLEY, "env.max_steps=3", "points=10", "progress=false", f"output={tmp_path / 'replay.html'}"]
    assert in_process(replay_command.main, f"policy={folder}", *arguments, f"data={data}") == 0
    (flight,) = load_recording(data).flights
    assert flight.faces.shape == (4, 72) and flight.observations.shape == (4, 3 * (72 + 3 + 4))


def chosen(folder: Path, *overrides: str) -> Any:
    config = compose(f"policy={folder}", *overrides, name="evaluate")
    return choose(validate(config, EvaluateConfig), config, [f"policy={folder}", *overrides], None, "cpu")


def test_environment_and_perception_are_the_contracts_unless_the_sensor_is_said_to_be_another(folder: Path) -> None:
    setup = chosen(folder)
    assert setup.perception["reduction"] == "range_image" and setup.perception["radius"] == 6.0
    assert setup.perception["lidar"].max_range == 6.0, "what the policy sees, the sensor reports"
    assert list(setup.env["airframe"].lidar_position) == [0.0, 0.0, 0.2]
    read = {"keep_cloud": True, "mark_resets": True, "recurrent_state": None, "policy_reads": setup.policy.in_keys}
    assert setup.env_options == {**read, "guards": GuardSettings()}
    other = chosen(folder, "env.airframe.lidar_position=[0,0,0.1]", "perception.lidar.max_range=50", "env=dynamic")
    assert list(other.env["airframe"].lidar_position) == [0.0, 0.0, 0.1] and other.env["world"].planes > 0
    assert other.perception["lidar"].max_range == 50.0 and other.perception["radius"] == 6.0


def test_a_suite_sees_that_it_was_exported_anew(folder: Path) -> None:
    settings = validate(compose(f"policy={folder}", name="evaluate"), EvaluateConfig)
    os.utime(folder / "contract.json", (5, 5))
    assert _changed(settings) == 5


@pytest.mark.parametrize("key", ["policy", "run"])
def test_guards_keep_its_limit_in_a_faster_environment(
    key: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits, made = [], environment.guarded

    def noted(*arguments: Any) -> Any:
        around = made(*arguments)
        limits.append(around.vehicle.velocity_limit)
        return around

    monkeypatch.setattr(environment, "guarded", noted)
    evaluation(tmp_path / "fast.json", f"{key}={folder}", "env.max_speed=6", "guards=[evasion]")
    assert limits == [2.0]


def test_a_tilted_lidar_of_ones_own_is_that_of_the_training(tmp_path: Path) -> None:
    """It does not see all that lies between its lowest and its highest ray."""
    lidar = tmp_path / "tilted.yaml"
    lidar.write_text("like: mid360\nmount: [0, 20, 0]\n")
    folder = exported(tmp_path, "algo.hidden=[16]", *CELLS, f"env.lidar={lidar}")
    ours = evaluation(tmp_path / "policy.json", f"policy={folder}", f"env.lidar={lidar}")
    theirs = evaluation(tmp_path / "run.json", f"run={folder}")
    assert ours["unseen_cells"] == theirs["unseen_cells"] == 0
    assert ours["outcomes"] == theirs["outcomes"]


def test_what_cannot_be_flown_ends_in_a_sentence(folder: Path, tmp_path: Path, refused: Refused) -> None:
    def told(*arguments: str) -> str:
        return refused(evaluate_command.main, *arguments, *SHORT)

    nowhere = tmp_path / "nowhere"
    assert f"Expected an exported policy with {nowhere}/contract.json" in told(f"policy={nowhere}")
    assert "Expected an exported policy with" in told(f"policy={tmp_path}")
    assert "perception belongs to the policy" in told(f"policy={folder}", "perception=truncated_icosahedron")
    assert "perception.radius belongs to the policy" in told(f"policy={folder}", "perception.radius=3")


def test_a_contract_of_another_reduction_ends_in_a_sentence(tmp_path: Path, refused: Refused) -> None:
    folder = exported(tmp_path, "algo.hidden=[4]")
    edit_contract(folder, lambda terms: terms["cells"].update(reduction="range_image"))
    assert "cells are not those of range_image" in refused(evaluate_command.main, f"policy={folder}", *SHORT)


def test_with_a_lidar_of_ones_own_it_flies_where_that_is_described(tmp_path: Path, refused: Refused) -> None:
    """The contract names it and has none of its rays."""
    lidar = tmp_path / "mine.yaml"
    lidar.write_text("name: mine\nelevations: [-14, -7, 0, 7, 14]\nazimuth_steps: 360\nmax_range: 30\n")
    folder = exported(tmp_path, "algo.hidden=[16]", *CELLS, f"env.lidar={lidar}")
    said = refused(evaluate_command.main, f"policy={folder}", *SHORT)
    assert "was trained with mine, a LiDAR of its own" in said and "with env.lidar=FILE.yaml" in said
    assert f"write run={folder}, which has them" in said
    ours = evaluation(tmp_path / "policy.json", f"policy={folder}", f"env.lidar={lidar}")
    theirs = evaluation(tmp_path / "run.json", f"run={folder}")
    assert ours["outcomes"] == theirs["outcomes"] and ours["lidar"] == theirs["lidar"] == "mine"
    for flown, expected in zip(ours["flights"], theirs["flights"], strict=True):
        assert flown["flown"] == pytest.approx(expected["flown"], abs=1e-3)
    other = evaluation(tmp_path / "other.json", f"policy={folder}", "allow_unseen=true")
    assert (other["lidar"], other["unseen_cells"]) == ("vlp16", 0), "another one than that of the training"
    unseen = evaluation(tmp_path / "unseen.json", f"policy={folder}", "env.lidar=rplidar", "allow_unseen=true")
    assert unseen["unseen_cells"] == 48, "as by its run"
    assert evaluation(tmp_path / "v.json", f"run={folder}", "env.lidar=vlp16")["lidar"] == "vlp16"
    lidar.write_text("name: mine\nelevations: [0]\nazimuth_steps: 360\nmax_range: 30\n")
    for name in ("policy", "run"):
        said = refused(evaluate_command.main, f"{name}={folder}", f"env.lidar={lidar}", *SHORT)
        assert "The LiDAR mine never sees 48 of the 72 cells that the policy was trained to read with mine" in said
        assert "uavrl-train env.lidar=FILE.yaml" in said
