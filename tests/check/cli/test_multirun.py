"""``-m`` trains one run for each combination of values, each in a folder of its own, and none twice."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.helpers.commands import TINY, content
from tests.helpers.sweeps import runs_in, sweep
from uavrl.cli import train as train_command


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("swept")
    assert sweep(folder, "seed=0,1") == 0
    return folder


def test_a_sweep_started_again_trains_what_is_missing_alone(swept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {seed: content(run) for seed, run in runs_in(swept).items() if seed in (0, 1)}
    capsys.readouterr()
    assert sweep(swept, "seed=0,1,2") == 0
    printed = capsys.readouterr().out
    assert printed.count("Finished: ") == 2
    assert printed.count("Run folder: ") == 1
    runs = runs_in(swept)
    assert sorted(runs) == [0, 1, 2]
    assert {seed: content(runs[seed]) for seed in (0, 1)} == before


def test_a_sweep_goes_on_with_runs_that_are_shorter_and_frees_folders_without_a_checkpoint(
    swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for run in (runs_in(swept)[seed] for seed in (0, 1)):
        shutil.copytree(run, tmp_path / run.name)
    runs = runs_in(tmp_path)
    first_rows = (runs[0] / "episodes.csv").read_text()
    for path in (*(runs[1] / "checkpoints").glob("*"), runs[1] / "summary.json", runs[1] / "episodes.csv"):
        path.unlink()
    (runs[1] / "checkpoints/.checkpoint-000000000000.torchrl.stage-1").touch()  # killed while it saved
    capsys.readouterr()
    assert sweep(tmp_path, "seed=0,1", "trainer.episodes=6") == 0
    printed = capsys.readouterr().out
    assert f"Resuming {runs[0]}" in printed
    assert f"Run folder: {runs[1]}" in printed
    assert runs_in(tmp_path) == runs
    assert (runs[0] / "episodes.csv").read_text().startswith(first_rows)
    assert not list(runs[1].glob("checkpoints/.*"))
    for run in runs.values():
        assert json.loads((run / "summary.json").read_text())["episodes"] == 6
        assert len((run / "episodes.csv").read_text().splitlines()) == 1 + 6


def test_a_run_that_its_steps_have_ended_is_left_alone_and_goes_on_for_more(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    longer = ["trainer.episodes=50", "seed=0"]
    assert [sweep(tmp_path, *longer, f"trainer.steps={steps}") for steps in (30, 30, 60)] == [0, 0, 0]
    printed = capsys.readouterr().out
    assert [printed.count(said) for said in ("Run folder: ", "Finished: ", "Resuming ")] == [1, 1, 1]


def test_a_run_whose_checkpoints_were_removed_keeps_what_it_has(
    swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Path(shutil.copytree(runs_in(swept)[0], tmp_path / runs_in(swept)[0].name))
    shutil.rmtree(run / "checkpoints")
    before = content(run)
    assert sweep(tmp_path, "seed=0") == 0
    assert "Finished: " in capsys.readouterr().out
    assert sweep(tmp_path, "seed=0", "trainer.episodes=6") == 1
    assert f"{run} contains 4 episodes but no checkpoint to resume from" in capsys.readouterr().err
    assert content(run) == before


def test_a_damaged_summary_is_written_again(swept: Path, tmp_path: Path) -> None:
    run = runs_in(swept)[0]
    summary = Path(shutil.copytree(run, tmp_path / run.name)) / "summary.json"
    whole = summary.read_text()
    summary.write_text(whole[:20])
    assert sweep(tmp_path, "seed=0") == 0
    assert json.loads(summary.read_text())["episodes"] == 4


JOBLIB = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
CLUSTER = ["hydra/launcher=submitit_local"]  # submitit's stand-in for a cluster: what a job prints stays in its files


BY_ANY_LAUNCHER = pytest.mark.parametrize(
    "launcher",
    [[], pytest.param(JOBLIB, marks=pytest.mark.slow), pytest.param(CLUSTER, marks=pytest.mark.slow)],
    ids=["basic", "joblib", "submitit_local"],
)


@BY_ANY_LAUNCHER
def test_a_sweep_ends_with_a_list_of_its_runs(
    swept: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], launcher: list[str]
) -> None:
    monkeypatch.chdir(swept)
    assert sweep(swept, "seed=1,0", *launcher) == 0
    runs = runs_in(swept)
    listed = ["The sweep's 2 runs:", *(f"  {runs[seed]}: 4 episodes" for seed in (1, 0))]
    assert capfd.readouterr().out.splitlines()[-3:] == listed


@BY_ANY_LAUNCHER
def test_the_other_runs_fly_when_one_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], launcher: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert sweep(tmp_path, "backward_reward=abr", "perception.frames=1,2", *launcher) == 1
    told = capfd.readouterr().err
    reason = "With backward_reward=abr perception.frames must be at least 2, got 1"
    assert f"of the sweep failed: {reason}" in told, "the last line has the reason"
    assert "Traceback" not in told
    (run,) = runs_in(tmp_path).values()
    assert json.loads((run / "summary.json").read_text())["episodes"] == 4


HOLD = """
import sys, time
from pathlib import Path
from uavrl.runs.lock import run_lock
with run_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_run_that_another_process_flies_is_left_alone_and_flown_when_that_one_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    assert sweep(tmp_path, "seed=0,1", "trainer.episodes=2") == 0
    first = runs_in(tmp_path)[0]
    with subprocess.Popen([sys.executable, "-c", HOLD, str(first)], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline() == b"held\n"
        looked: list[float] = []

        def look_again(seconds: float) -> None:
            looked.append(seconds)
            if len(looked) == 1:
                return  # the other one lives: the list is not gone over again
            assert json.loads((runs_in(tmp_path)[1] / "summary.json").read_text())["episodes"] == 4, "the rest is flown"
            assert json.loads((first / "summary.json").read_text())["episodes"] < 4
            other.kill()
            other.wait()

        monkeypatch.setattr(train_command.time, "sleep", look_again)
        capfd.readouterr()
        assert sweep(tmp_path, "seed=0,1") == 0
    told = capfd.readouterr()
    assert (
        len(looked) == 2
        and told.err.count("Another process") == 1
        and f"Another process (process {other.pid} on " in told.err
    )
    assert json.loads((first / "summary.json").read_text())["episodes"] == 4
    assert told.out.count("Finished: ") == 0 and "Waiting until other processes finish 1 run of the sweep" in told.err
    assert told.out.splitlines()[-3:] == [
        "The sweep's 2 runs:",
        *(f"  {runs_in(tmp_path)[seed]}: 4 episodes" for seed in (0, 1)),
    ]


@pytest.mark.slow
def test_four_processes_share_a_sweep_and_two_of_them_are_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "uavrl.cli.train", "-m", *TINY, "trainer.episodes=12"]
    command += [f"run_dir={tmp_path / 'run'}", f"hydra.sweep.dir={tmp_path / 'sweep'}", "seed=range(12)"]
    started = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) for _ in range(4)]
    for victim, enough in zip(started, (2, 5), strict=False):  # killed once so many runs have ended
        while len(list(tmp_path.glob("run*/summary.json"))) < enough:
            assert victim.poll() is None
            time.sleep(0.2)
        victim.kill()
    told = [process.communicate(timeout=1800)[0] for process in started]
    assert [process.returncode for process in started] == [-9, -9, 0, 0], told
    runs = runs_in(tmp_path)
    assert sorted(runs) == list(range(12))
    for run in runs.values():
        assert json.loads((run / "summary.json").read_text())["episodes"] == 12
        lines = (run / "episodes.csv").read_text().splitlines()[1:]
        assert [int(line.split(",")[0]) for line in lines] == list(range(1, 13)), "each episode once"
    for text in told[2:]:
        assert "The sweep's 12 runs:" in text and text.count(": 12 episodes") == 12
    begun = [line for text in told for line in text.splitlines() if line.startswith("Run folder: ")]
    assert 12 <= len(set(begun)) == len(runs) <= len(begun) <= 14, "flown anew only where a killed process had it"
