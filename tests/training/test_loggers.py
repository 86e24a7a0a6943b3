"""What a run logs by default, and loggers that cannot begin; tests/check trains with the others."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig

from tests.helpers.commands import TINY
from tests.helpers.configs import composed
from tests.helpers.finished import finished_run
from tests.helpers.runs import small_config
from uavrl.cli import train as train_command
from uavrl.config import validate
from uavrl.errors import UavrlError
from uavrl.training.loggers import require_login
from uavrl.training.run import create_run, train


def test_csv(tmp_path: Path) -> None:
    logs = finished_run(tmp_path / "run", *TINY, "logger.interval=1") / "logs"
    names = {p.stem for p in logs.rglob("*.csv")}
    assert {"rate_arrived", "rate_collided", "rate_timed_out", "return", "episodes"} <= names
    (episodes,) = logs.rglob("episodes.csv")
    assert [float(line.split(",")[-1]) for line in episodes.read_text().splitlines()][-1] == 4.0


@pytest.mark.parametrize(("name", "flag"), [("tensorboard", "_has_tb"), ("wandb", "_has_wandb")])
def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, flag: str) -> None:
    # TorchRL looks for the package once, when it is imported.
    monkeypatch.setattr(importlib.import_module(f"torchrl.record.loggers.{name}"), flag, False)
    config = small_config(tmp_path / "run", f"logger={name}", "trainer.episodes=1")
    run_dir = create_run(config)
    with pytest.raises(UavrlError, match=rf"logger={name} needs .* pip install 'uavrl\[{name}\]'"):
        train(config, run_dir)
    create_run(config)  # nothing was flown: the folder is free for another try


def test_wandb_without_a_login_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    wandb = pytest.importorskip("wandb")

    def no_login(*_: object, **__: object) -> None:
        raise wandb.errors.UsageError("No API key configured. Use `wandb login` to log in.")

    run_dir = tmp_path / "run"
    asked = [*TINY, "logger=wandb", "logger.offline=false"]
    for place in ("login", "init"):  # no login, and one that the server refuses
        with monkeypatch.context() as patch:
            patch.setattr(wandb, "login", lambda **_: True)
            patch.setattr(wandb, place, no_login)
            if place == "login":  # found before a folder is made, or is looked at to go on
                patch.setattr("uavrl.training.run.create_run", pytest.fail)
            sentence = refused(train_command.main, *asked, f"run_dir={run_dir}")
        assert "logger=wandb could not begin (No API key configured" in sentence and "wandb login" in sentence
        assert not list(tmp_path.iterdir())


def wandb_logger(offline: bool) -> DictConfig:
    return validate(composed("config", "logger=wandb", f"logger.offline={offline}")).logger


def test_wandb_needs_a_key_online_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    require_login(wandb_logger(offline=True))
    for name in ("WANDB_API_KEY", "WANDB_MODE", "WANDB_IDENTITY_TOKEN_FILE"):
        monkeypatch.delenv(name, raising=False)
    for name in ("NETRC", "WANDB_CONFIG_DIR", "WANDB_CACHE_DIR", "WANDB_DATA_DIR", "WANDB_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    with pytest.raises(UavrlError, match=r"logger=wandb could not begin \(No API key .* log in with wandb login"):
        require_login(wandb_logger(offline=False))
