"""What a run logs by default; tests/check trains with the other loggers."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from tests.helpers.commands import TINY
from tests.helpers.finished import finished_run
from tests.helpers.runs import small_config
from uavrl.errors import UavrlError
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
