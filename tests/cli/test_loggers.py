"""Every logger writes below the run folder, and a missing package is named in one sentence."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from tests.training.test_resume import small_config
from uavrl.errors import UavrlError
from uavrl.training.checkpoint import rotation
from uavrl.training.run import create_run, train


def trained(folder: Path, monkeypatch: pytest.MonkeyPatch, *overrides: str) -> Path:
    """Trains in an empty working directory that must stay empty; returns the run folder."""
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    config = small_config(folder / "run", "trainer.episodes=6", "algo.random_steps=20", "logger.interval=1", *overrides)
    run_dir = create_run(config)
    train(config, run_dir)
    assert not list(elsewhere.rglob("*"))
    assert {p.name for p in folder.iterdir()} == {"elsewhere", "run"}
    return run_dir


def test_csv(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_dir = trained(tmp_path, monkeypatch)
    names = {p.stem for p in (run_dir / "logs").rglob("*.csv")}
    assert {"rate_arrived", "rate_collided", "rate_timed_out", "return", "episodes"} <= names
    (episodes,) = (run_dir / "logs").rglob("episodes.csv")
    assert [float(line.split(",")[-1]) for line in episodes.read_text().splitlines()][-1] == 6.0


def test_tensorboard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run_dir = trained(tmp_path, monkeypatch, "logger=tensorboard")
    (events,) = (run_dir / "logs").rglob("events.out.tfevents.*")
    accumulator = EventAccumulator(str(events.parent))
    accumulator.Reload()
    assert {"rate_arrived", "return", "loss_value"} <= {t.rpartition("/")[2] for t in accumulator.Tags()["scalars"]}


def test_wandb_offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    for name in ("WANDB_DIR", "WANDB_MODE", "WANDB_API_KEY"):
        monkeypatch.delenv(name, raising=False)
    for name in ("WANDB_CACHE_DIR", "WANDB_CONFIG_DIR", "WANDB_DATA_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "run/wandb-own"))
    run_dir = trained(tmp_path, monkeypatch, "logger=wandb")
    assert list((run_dir / "logs").rglob("run-*.wandb"))


def test_a_run_with_another_logger_learns_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("tensorboard")
    runs = []
    for name in ("csv", "tensorboard"):
        folder = tmp_path / name
        folder.mkdir()
        runs.append(trained(folder, monkeypatch, f"logger={name}"))
    assert (runs[0] / "episodes.csv").read_bytes() == (runs[1] / "episodes.csv").read_bytes()
    assert all(rotation(run).latest() for run in runs)


@pytest.mark.parametrize(("name", "flag"), [("tensorboard", "_has_tb"), ("wandb", "_has_wandb")])
def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, flag: str) -> None:
    # TorchRL looks for the package once, when it is imported.
    monkeypatch.setattr(importlib.import_module(f"torchrl.record.loggers.{name}"), flag, False)
    config = small_config(tmp_path / "run", f"logger={name}", "trainer.episodes=1")
    run_dir = create_run(config)
    with pytest.raises(UavrlError) as error:
        train(config, run_dir)
    assert str(error.value) == f"logger={name} needs the package {name}: run pip install 'uavrl[{name}]'."
    create_run(config)  # nothing was flown: the folder is free for another try
