"""Bad input ends in one sentence and a non-zero exit code, without a traceback and without any loss."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from filelock import FileLock
from omegaconf import OmegaConf

from tests.helpers.commands import SMALL_EVALUATION, TINY, content, in_process, newest
from tests.helpers.damage import empty, flip_in_the_directory, flip_in_the_middle, flip_in_the_networks, halve
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import train as train_command
from uavrl.models import Actor


@pytest.fixture
def run_dir(finished: Path, tmp_path: Path) -> Path:
    """A copy of a finished run with a row in episodes.csv that no checkpoint knows: a resume would cut it off."""
    copy = Path(shutil.copytree(finished, tmp_path / "run"))
    with (copy / "episodes.csv").open("a") as file:
        file.write((copy / "episodes.csv").read_text().splitlines()[-1].replace("4,", "5,", 1) + "\n")
    return copy


def test_the_fixture_run_can_be_resumed_and_evaluated(
    run_dir: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert in_process(train_command.main, f"resume={run_dir}", "trainer.episodes=5") == 0
    assert len((run_dir / "episodes.csv").read_text().splitlines()) == 1 + 5
    (run_dir / "evaluation.json").write_text("500 tasks")
    assert in_process(evaluate_command.main, f"run={run_dir}", *SMALL_EVALUATION) == 0
    assert json.loads((run_dir / "evaluation_episodes=2.json").read_text())["episodes"] == 2
    assert (run_dir / "evaluation.json").read_text() == "500 tasks", "a quick look takes no long evaluation's place"
    assert "Traceback" not in "".join(capfd.readouterr())


# ---------------------------------------------------------------------- starting a run


def test_a_run_folder_that_cannot_be_made_is_named(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "file").write_text("kept")
    sentence = refused(train_command.main, *TINY, f"run_dir={tmp_path / 'file' / 'run'}")
    assert f"{tmp_path / 'file' / 'run'} cannot be written" in sentence and "run_dir=FOLDER" in sentence
    assert content(tmp_path) == {"file": b"kept"}


@pytest.mark.parametrize("lost", [None, "config.yaml"])
def test_a_run_folder_in_use_is_left_alone(lost: str | None, run_dir: Path, refused: Callable[..., str]) -> None:
    if lost is not None:
        (run_dir / lost).unlink()
    before = content(run_dir)
    sentence = refused(train_command.main, *TINY, f"run_dir={run_dir}")
    assert "already contains a run" in sentence and f"resume={run_dir}" in sentence
    assert content(run_dir) == before


# ---------------------------------------------------------------------- resuming


def test_resuming_a_missing_folder_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    sentence = refused(train_command.main, f"resume={tmp_path / 'none'}")
    assert f"Expected a run folder at {tmp_path / 'none'} and found none" in sentence
    (tmp_path / "none").mkdir()
    sentence = refused(train_command.main, f"resume={tmp_path / 'none'}")
    assert f"The folder {tmp_path / 'none'} contains no run, because config.yaml is missing" in sentence
    assert not list((tmp_path / "none").iterdir())


def test_resuming_without_checkpoints_is_refused(run_dir: Path, refused: Callable[..., str]) -> None:
    shutil.rmtree(run_dir / "checkpoints")
    before = content(run_dir)
    assert "Expected a checkpoint in" in refused(train_command.main, f"resume={run_dir}")
    assert content(run_dir) == before


@pytest.mark.parametrize(
    "damage", [empty, halve, flip_in_the_middle, flip_in_the_networks, flip_in_the_directory], ids=lambda d: d.__name__
)
def test_a_damaged_checkpoint_is_named(
    damage: Callable[[Path], None], run_dir: Path, refused: Callable[..., str]
) -> None:
    damage(newest(run_dir))
    before = content(run_dir)
    said = f"The checkpoint {newest(run_dir)} is damaged"
    sentence = refused(evaluate_command.main, f"run={run_dir}", *SMALL_EVALUATION)
    assert said in sentence and "uavrl-train resume=RUN_FOLDER goes back to the one before" in sentence
    assert content(run_dir) == before


def test_a_run_whose_checkpoints_are_all_damaged_is_refused(run_dir: Path, refused: Callable[..., str]) -> None:
    for path in (run_dir / "checkpoints").iterdir():
        empty(path)
    before = content(run_dir)
    sentence = refused(train_command.main, f"resume={run_dir}")
    assert f"The checkpoint {newest(run_dir)} is damaged" in sentence and "No older checkpoint is left" in sentence
    assert content(run_dir) == before


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.9])
def test_a_truncated_configuration_is_refused(share: float, run_dir: Path, refused: Callable[..., str]) -> None:
    path = run_dir / "config.yaml"
    path.write_text(path.read_text()[: int(share * path.stat().st_size)])
    before = content(run_dir)
    refused(train_command.main, f"resume={run_dir}", "trainer.episodes=9")
    refused(evaluate_command.main, f"run={run_dir}", *SMALL_EVALUATION)
    assert content(run_dir) == before


@pytest.mark.parametrize(("key", "said"), [("gama", "gama"), ("gamma", "was written under another configuration")])
def test_a_configuration_that_is_not_the_runs_is_refused(
    key: str, said: str, run_dir: Path, refused: Callable[..., str]
) -> None:
    config = OmegaConf.load(run_dir / "config.yaml")
    config.algo[key] = 0.9
    OmegaConf.save(config, run_dir / "config.yaml")
    before = content(run_dir)
    for main, argument in ((train_command.main, f"resume={run_dir}"), (evaluate_command.main, f"run={run_dir}")):
        assert said in refused(main, argument)
    assert content(run_dir) == before


@pytest.mark.parametrize("override", ["algo=ddpg", "algo.gamma=0.9", "env=dynamic", "seed=1", "trainer.episodes=0"])
def test_resuming_with_other_settings_is_refused_by_name(
    override: str, run_dir: Path, refused: Callable[..., str]
) -> None:
    before = content(run_dir)
    reason = "must be" if override == "trainer.episodes=0" else "would change it"
    assert f"{override.split('=')[0]} {reason}" in refused(train_command.main, f"resume={run_dir}", override)
    assert content(run_dir) == before


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "found no such file"),
        ("a,b\n1,2\n", "has no column `episode`: it was not written by this version of uavrl-train"),
        ("short", "has lost those after 1"),
    ],
    ids=["missing", "foreign", "too short for the one checkpoint that is left"],
)
def test_resuming_without_the_runs_episodes_is_refused(
    text: str | None, said: str, run_dir: Path, refused: Callable[..., str]
) -> None:
    path = run_dir / "episodes.csv"
    lines = path.read_text().splitlines(keepends=True)
    path.unlink()
    if text == "short":
        min((run_dir / "checkpoints").iterdir()).unlink()
    if text is not None:
        path.write_text("".join(lines[:2]) if text == "short" else text)
    before = content(run_dir)
    assert said in refused(train_command.main, f"resume={run_dir}", "trainer.episodes=9")
    assert content(run_dir) == before


# ---------------------------------------------------------------------- evaluating


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run=r", "policy=straight"], "not both"),
        (["run=none"], "Expected a run folder at none and found none"),
        (["policy=straight", "output=file/result.json"], "file/result.json cannot be written"),
        (["policy=straight", "output=folder"], "folder cannot be written"),
        (["policy=straight", "env=dynamic", "env.world.plane_keep_out=50"], "plane_keep_out or planes"),
    ],
)
def test_evaluation_refuses(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    refused: Callable[..., str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("kept")
    (tmp_path / "folder").mkdir()
    assert said in refused(evaluate_command.main, *arguments, *SMALL_EVALUATION)
    assert content(tmp_path) == {"file": b"kept"}


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("checkpoint=none.torchrl", "Expected a checkpoint at none.torchrl and found none"),
        ("perception.frames=7", "perception.frames belongs to the run"),
    ],
)
def test_what_a_run_has_not_or_cannot_change_is_named(
    override: str, said: str, run_dir: Path, refused: Callable[..., str]
) -> None:
    before = content(run_dir)
    assert said in refused(evaluate_command.main, f"run={run_dir}", *SMALL_EVALUATION, override)
    assert content(run_dir) == before


def test_two_processes_do_not_share_a_run_folder(run_dir: Path, refused: Callable[..., str]) -> None:
    before = content(run_dir)
    with FileLock(run_dir / ".lock"):
        sentence = refused(train_command.main, f"resume={run_dir}", "trainer.episodes=9")
    assert "Another process trains in" in sentence
    assert {**content(run_dir), ".lock": b""} == {**before, ".lock": b""}


def not_a_number(actor: Actor, observation: torch.Tensor) -> torch.Tensor:
    return torch.full((*observation.shape[:-1], 4), torch.nan)


def test_nan_actions_end_a_training_in_one_sentence(
    tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Actor, "forward", not_a_number)
    sentence = refused(train_command.main, *TINY, f"run_dir={tmp_path / 'run'}", "algo.learning_starts=0")
    assert "got NaN" in sentence
    assert newest(tmp_path / "run").is_file()


def test_nan_actions_end_an_evaluation_in_one_sentence(
    run_dir: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Actor, "forward", not_a_number)
    assert "got NaN" in refused(evaluate_command.main, f"run={run_dir}", *SMALL_EVALUATION)
    assert not list(run_dir.glob("evaluation*"))


def test_an_evaluation_changes_one_value_of_the_runs_environment_and_says_so_in_its_name(run_dir: Path) -> None:
    arguments = [f"run={run_dir}", *SMALL_EVALUATION, "env.max_steps=3", "env.world.min_clearance=1.0"]
    assert in_process(evaluate_command.main, *arguments) == 0
    written = run_dir / "evaluation_env.max_steps=3_env.world.min_clearance=1.0_episodes=2.json"
    result = json.loads(written.read_text())
    assert max(flight["steps"] for flight in result["flights"]) == 3
    assert result["overrides"][-2:] == ["env.max_steps=3", "env.world.min_clearance=1.0"]
    assert in_process(evaluate_command.main, f"run={run_dir}", *SMALL_EVALUATION, "valleys=[4,5]") == 0
    assert json.loads((run_dir / "evaluation_valleys=4-5_episodes=2.json").read_text())["valleys"] == [4, 5]


@pytest.mark.parametrize("override", ["perception.blind=true", "perception.blind_to=planes"])
def test_an_evaluation_may_take_the_sight_from_a_policy_that_was_trained_seeing(run_dir: Path, override: str) -> None:
    assert in_process(evaluate_command.main, f"run={run_dir}", *SMALL_EVALUATION, override) == 0
    result = json.loads((run_dir / f"evaluation_{override}_episodes=2.json").read_text())
    assert override in result["overrides"]


def test_ctrl_c_in_the_middle_of_an_update_is_still_ctrl_c(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    forward = Actor.forward

    def interrupted_while_learning(actor: Actor, observation: torch.Tensor) -> torch.Tensor:
        if torch.is_grad_enabled():
            raise KeyboardInterrupt
        return forward(actor, observation)

    monkeypatch.setattr(Actor, "forward", interrupted_while_learning)
    assert in_process(train_command.main, *TINY, f"run_dir={tmp_path / 'run'}") == 130
    _, err = capfd.readouterr()
    assert [line for line in err.splitlines() if line.startswith("uavrl: ")] == err.splitlines()[-1:]
    assert f"uavrl-train resume={tmp_path / 'run'} continues after episode 0 and repeats" in err
    assert "Traceback" not in err
