"""``uavrl-replay`` end to end on a tiny run; bad input ends in one sentence and leaves no file."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.helpers.commands import TINY, in_process
from tests.helpers.finished import finished_run
from tests.helpers.logged import write_log
from tests.helpers.pages import Page, unpack
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import replay as command
from uavrl.evaluation.actor import read_policy
from uavrl.evaluation.recording import load_recording

WORLD = ["env.world.size=[26,20]", "env.world.obstacles=6"]
SMALL = ["progress=false", "points=40"]


def content(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def data_of(page: Path) -> dict[str, Any]:
    return json.loads(Page(page.read_text()).scripts["data"])


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    chosen = ["lifeguard=linear", "reward=traditional"]
    return finished_run(tmp_path_factory.mktemp("runs") / "guarded", *TINY, *WORLD, *chosen)


def test_a_run_is_shown_with_its_own_reward_and_the_risk_that_its_lifeguard_sees(
    run_dir: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    page, data = tmp_path / "page.html", tmp_path / "flights.npz"
    arguments = [f"run={run_dir}", "tasks=[0,3]", f"output={page}", f"data={data}", *SMALL]
    assert in_process(command.main, *arguments) == 0
    out = capfd.readouterr().out
    assert "task 0: " in out and "task 3: " in out and f"Written to {page}" in out
    shown, kept = data_of(page), load_recording(data)
    assert shown["source"]["run"] == "guarded" and shown["source"]["seed"] == 20_000
    assert [flight["task"] for flight in shown["flights"]] == [0, 3]
    for flight, whole in zip(shown["flights"], kept.flights, strict=True):
        assert flight["reward_names"] == ["progress", "arrival", "collision"]
        risks = unpack(flight["risks"])
        assert risks.shape == (flight["steps"],) and ((risks >= 0) & (risks <= 1)).all()
        np.testing.assert_array_equal(unpack(flight["positions"]), whole.positions)
    assert content(tmp_path) == ["flights.npz", "page.html"]


def test_the_policy_of_the_run_flies(run_dir: Path, tmp_path: Path) -> None:
    data = tmp_path / "f.npz"
    assert in_process(command.main, f"run={run_dir}", f"output={tmp_path / 'p.html'}", f"data={data}", *SMALL) == 0
    (flight,) = load_recording(data).flights
    policy = read_policy(run_dir)
    states = TensorDict({"observation": torch.from_numpy(flight.observations[:-1])}, [flight.summary.steps])
    with torch.no_grad():
        np.testing.assert_allclose(policy(states)["action"].numpy(), flight.actions, atol=1e-5)
    assert policy.source["run"] == str(run_dir)


def test_the_page_goes_into_the_run_and_its_name_tells_what_was_changed(
    run_dir: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert in_process(command.main, f"run={run_dir}", "task=2", "env.max_steps=3", *SMALL) == 0
    page = run_dir / "replay_task=2_env.max_steps=3.html"
    (flight,) = data_of(page)["flights"]
    assert (flight["outcome"], flight["steps"], flight["path_efficiency"]) == ("timed_out", 3, None)
    assert "task 2: time-out after 3 steps, minimum clearance " in capfd.readouterr().out, "and of no path's efficiency"
    page.unlink()


def test_what_an_evaluation_prints_shows_its_world_also_of_yaml_files_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my yaml's/env").mkdir(parents=True)
    (tmp_path / "my yaml's/env/mine.yaml").write_text("defaults: [static, _self_]\nmax_steps: 3\n")
    monkeypatch.chdir(tmp_path)
    told = ["--config-dir", "my yaml's", "policy=straight", "env=mine", "seed=5", *WORLD]
    assert in_process(evaluate_command.main, *told, "episodes=1", "progress=false") == 0
    name, *typed = shlex.split(capfd.readouterr().out.partition("Watch it fly: ")[2])
    assert name == "uavrl-replay"
    assert in_process(command.main, *typed, "output=page.html", *SMALL) == 0
    shown = data_of(tmp_path / "page.html")
    assert (shown["source"]["env"], shown["source"]["seed"], shown["flights"][0]["steps"]) == ("mine", 5, 3)


def test_a_policy_that_sees_nothing_is_shown_without_points(run_dir: Path, tmp_path: Path) -> None:
    data = tmp_path / "blind.npz"
    assert in_process(command.main, f"run={run_dir}", "perception.blind=true", f"data={data}", *SMALL) == 0
    (flight,) = load_recording(data).flights
    assert not flight.faces.any() and len(flight.points) == 0
    (run_dir / "replay_perception.blind=true.html").unlink()


def test_flights_in_a_file_make_the_same_page_again(tmp_path: Path) -> None:
    first = ["policy=straight", "env.max_steps=4", "episodes=2", *WORLD, f"data={tmp_path / 'f.npz'}"]
    assert in_process(command.main, *first, f"output={tmp_path / 'a.html'}", *SMALL) == 0
    again = [f"flight={tmp_path / 'f.npz'}", f"output={tmp_path / 'b.html'}", "progress=false"]
    assert in_process(command.main, *again) == 0
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    assert data_of(tmp_path / "a.html")["flights"][0]["risks"]["shape"] == [0]


def test_a_video_takes_the_place_of_the_page(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["policy=straight", "env.max_steps=3", *WORLD, f"video={tmp_path / 'f.gif'}", *SMALL]
    assert in_process(command.main, *arguments) == 0
    assert f"Written to {tmp_path / 'f.gif'}" in capfd.readouterr().out
    assert content(tmp_path) == ["f.gif"] and (tmp_path / "f.gif").read_bytes().startswith(b"GIF89a")


@pytest.mark.parametrize(("suffix", "missing"), [(".mp4", "av"), (".gif", "PIL")])
def test_a_video_whose_library_is_missing_is_refused_before_anything_flies(
    suffix: str, missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    monkeypatch.setattr("uavrl.evaluation.environment.make_env", None)  # what flies first makes an environment
    said = refused(command.main, "policy=straight", f"video={tmp_path / 'f'}{suffix}", *SMALL)
    assert f"needs {missing}, which is not installed: pip install 'uavrl[video]'" in said
    assert not list(tmp_path.iterdir())


def test_the_log_of_a_real_flight_makes_a_page_beside_it(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    log, _ = write_log(tmp_path / "evening.mcap", 20)
    assert in_process(command.main, f"flight={log}", "points=40") == 0
    out = capfd.readouterr().out
    assert f"{log}: ended, time 1.6 s" in out
    assert content(tmp_path) == ["evening.html", "evening.mcap"]
    assert data_of(tmp_path / "evening.html")["source"]["log"] == "evening.mcap"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "Give one of run=RUN_FOLDER, policy=NAME and flight=FILE.npz"),
        (["policy=straight", "run=x"], "and no two of them"),
        (["policy=clever"], "policy must be one of straight"),
        (["policy=straight", "task=-1"], "task must be a number from 0, got -1"),
        (["policy=straight", "tasks=[0,-2]"], "tasks must be a list of different numbers from 0"),
        (["policy=straight", "tasks=[1,1]"], "tasks must be a list of different numbers from 0"),
        (["policy=straight", "task=1", "episodes=2"], "one of task, tasks and episodes"),
        (["policy=straight", "episodes=51"], "at most 50 in one page"),
        (["policy=straight", "points=0"], "points must be at least 1"),
        (["run=nothing"], "Expected a run folder at nothing and found none"),
        (["flight=nothing.npz"], "found no such file"),
        (["flight=nothing.npz", "task=1"], "leave task out"),
        (["flight=nothing.mcap"], "nothing.mcap cannot be read (No such file or directory)"),
        (["flight=nothing.mcap", "data=f.npz"], "data must be left out with a log"),
        (["flight=nothing.mcap", "video=f.gif"], "video must be left out with a log"),
        (["policy=straight", "video=flight.avi"], "video must be a file that ends in .mp4 or .gif, got 'flight.avi'"),
        (["policy=straight", "tasks=[1,2]", "video=f.gif"], "A video shows one episode, and you asked for 2"),
        (["policy=straight", "video=/dev/null/f.gif"], "/dev/null/f.gif cannot be written (/dev/null is no folder)"),
    ],
)
def test_bad_input_is_refused_by_name(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refused(command.main, *arguments, "progress=false")
    assert not list(tmp_path.iterdir())


def test_an_empty_run_folder_and_a_missing_checkpoint_are_named(
    run_dir: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    (tmp_path / "empty").mkdir()
    assert "contains no run, because config.yaml is missing" in refused(command.main, f"run={tmp_path / 'empty'}")
    assert "reward belongs to the run" in refused(command.main, f"run={run_dir}", "reward=navigation")
    missing = run_dir / "checkpoints/none.torchrl"
    assert f"Expected a checkpoint at {missing}" in refused(command.main, f"run={run_dir}", f"checkpoint={missing}")


def test_what_cannot_be_written_is_named_before_anything_is_flown(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "file").write_text("kept")
    for key in ("output", "data"):
        keys = {"output": tmp_path / "page.html", key: tmp_path / "file" / "x.mp4"}
        sentence = refused(command.main, "policy=straight", *(f"{name}={path}" for name, path in keys.items()))
        assert f"choose another with {key}=FILE" in sentence
    assert content(tmp_path) == ["file"]


def test_a_package_that_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    assert "pip install 'uavrl-onboard[pages]'" in refused(
        command.main, "policy=straight", f"output={tmp_path / 'page.html'}"
    )
    assert not list(tmp_path.iterdir())
