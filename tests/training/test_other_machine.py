"""A run goes on, and a sweep is shared, on machines that have other devices, compilers and libraries."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from tests.helpers.commands import in_process
from tests.helpers.configs import changed, with_run_dir
from tests.helpers.runs import SMALL, assert_same_run, small_config
from uavrl.cli import train as train_command
from uavrl.errors import UavrlError
from uavrl.runs.checkpoint import checkpoint_to_resume, rotation
from uavrl.runs.config import MACHINE_KEYS, free_keys, read_config
from uavrl.training import matmul as arithmetic
from uavrl.training.run import create_run, resume_config, train
from uavrl.training.sweep import run_folder

OTHER = {"device": "cuda", "trainer.execution": "eager", "trainer.threads": 2, "trainer.matmul": "onednn"}


@pytest.fixture
def without_onednn(monkeypatch: pytest.MonkeyPatch) -> None:
    obstacle = "PyTorch does not hand products to oneDNN on this machine; choose mkl"
    monkeypatch.setattr(arithmetic, "_obstacle", lambda name: None if name == "mkl" else obstacle)


def recorded(run_dir: Path, **values: str) -> Path:
    """A run folder that another machine has made."""
    run_dir = create_run(small_config(run_dir))
    config = read_config(run_dir)
    for key, value in values.items():
        OmegaConf.update(config, key.replace("__", "."), value)
    (run_dir / "config.yaml").write_text(OmegaConf.to_yaml(config))
    return run_dir


@pytest.mark.usefixtures("without_onednn")
def test_products_that_this_machine_has_not_become_its_own(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    run_dir = recorded(tmp_path / "run", trainer__matmul="onednn")
    config = resume_config(run_dir, small_config(run_dir), [])
    assert config.trainer.matmul == "mkl"
    assert caplog.messages == [
        f"{run_dir} continues with trainer.matmul=mkl (before: onednn): from here on the last digits may differ."
    ]


def test_a_run_may_leave_its_gpu_and_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    run_dir = recorded(tmp_path / "run", device="cuda")
    assert resume_config(run_dir, small_config(run_dir), ["device"]).device == "cpu"
    assert "continues with device=cpu (before: cuda)" in caplog.text
    with pytest.raises(UavrlError, match=r"algo\.gamma would change it"):
        resume_config(run_dir, changed(["run_dir=here", *SMALL], "algo.gamma=0.5"), ["algo.gamma"])


def test_a_run_on_the_machine_that_it_knows_says_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    run_dir = create_run(small_config(tmp_path / "run"))
    before = (run_dir / "config.yaml").read_text()
    assert OmegaConf.to_yaml(resume_config(run_dir, small_config(run_dir), [])) == before
    assert not caplog.messages


@pytest.mark.parametrize("key", MACHINE_KEYS)
def test_a_sweep_s_folder_is_the_same_on_every_machine(key: str, tmp_path: Path) -> None:
    one, other = (with_run_dir(tmp_path / "run", *SMALL) for _ in range(2))
    OmegaConf.update(other, key, OTHER[key])
    assert run_folder(one, {}) == run_folder(other, {})
    OmegaConf.update(other, "seed", 5)
    other.run_dir = one.run_dir = "here"
    assert run_folder(one, {}) != run_folder(other, {})


def test_a_sweep_keeps_what_a_run_has_chosen_by_itself() -> None:
    config = with_run_dir(Path("run"), "device=auto", "trainer.matmul=auto", "trainer.execution=eager")
    keys = free_keys(config)
    assert "trainer.matmul" not in keys
    assert {"device", "trainer.execution", "trainer.threads", "trainer.episodes"} <= set(keys)


def from_another_machine(run_dir: Path, **machine: str | int) -> Path:
    """Makes a run one that was trained on another machine."""
    config = read_config(run_dir)
    config.trainer.update(machine)
    (run_dir / "config.yaml").write_text(OmegaConf.to_yaml(config))
    return run_dir


def more_of(run_dir: Path, *changed_keys: str) -> DictConfig:
    return resume_config(run_dir, small_config(run_dir, "trainer.episodes=8"), ["trainer.episodes", *changed_keys])


def test_a_run_from_another_machine_goes_on_as_any_other(run_dir: Path, tmp_path: Path) -> None:
    other = from_another_machine(Path(shutil.copytree(run_dir, tmp_path / "other/run")), threads=2)
    train(more_of(run_dir), run_dir, resume=True)
    train(more_of(other, "trainer.threads"), other, resume=True)
    assert read_config(other).trainer == read_config(run_dir).trainer
    assert_same_run(run_dir, other)


@pytest.mark.parametrize(("killed_in", "threads"), [("run._write", 2), ("trainer.EpisodeTrainer.train", 1)])
def test_it_goes_on_again_wherever_it_was_killed(
    killed_in: str, threads: int, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from_another_machine(run_dir, threads=2)
    monkeypatch.setattr(f"uavrl.training.{killed_in}", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train(more_of(run_dir, "trainer.threads"), run_dir, resume=True)
    assert read_config(run_dir).trainer.threads == threads
    assert checkpoint_to_resume(run_dir, read_config(run_dir)) == rotation(run_dir).latest()


def test_a_run_goes_on_with_its_own_configuration_alone(run_dir: Path) -> None:
    other = read_config(run_dir)
    other.algo.gamma = 0.9
    with pytest.raises(UavrlError, match="was trained under another configuration than the one given"):
        train(other, run_dir, resume=True)


@pytest.mark.parametrize("mode", [[], ["-m"]])
def test_a_device_that_is_not_here_is_refused_before_a_folder_is_told_or_made(
    mode: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("uavrl.training.run.create_run", pytest.fail)
    places = [f"run_dir={tmp_path / 'run'}", f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    assert in_process(train_command.main, *mode, *SMALL, "device=cuda:99", *places) == 1
    out, err = capfd.readouterr()
    assert out == "" and "use device=cpu" in err
    assert not list(tmp_path.glob("run*"))


def test_two_combinations_that_are_one_run_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("uavrl.training.sweep.is_finished", lambda *_: True)
    places = [f"run_dir={tmp_path / 'run'}", f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    assert in_process(train_command.main, "-m", *SMALL, "trainer.threads=1,2", *places) == 1
    assert "Two combinations of the sweep have the same run folder" in capfd.readouterr().err
