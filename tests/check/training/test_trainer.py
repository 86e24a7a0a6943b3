"""Trainings that go on when they are given more."""

from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.helpers.runs import EASY, small_config
from uavrl.runs.episodes import read_episodes
from uavrl.training.run import create_run, resume_config, train
from uavrl.training.sweep import is_finished


def test_a_run_ends_with_the_flight_that_makes_its_last_step_and_goes_on_when_given_more(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", *EASY, "trainer.steps=90", "trainer.episodes=300")
    summary = train(config, create_run(config))
    flown = [episode.total_steps for episode in read_episodes(tmp_path / "run" / "episodes.csv")]
    assert [steps >= 90 for steps in flown] == [False] * (len(flown) - 1) + [True]
    assert summary["steps"] == flown[-1]
    assert is_finished(tmp_path / "run", 300, 90) and not is_finished(tmp_path / "run", 300, 200)
    more = resume_config(tmp_path / "run", OmegaConf.merge(config, {"trainer": {"steps": 200}}), ["trainer.steps"])
    assert train(more, tmp_path / "run", resume=True)["steps"] >= 200
    assert [e.total_steps for e in read_episodes(tmp_path / "run" / "episodes.csv")][: len(flown)] == flown


def test_minutes_are_logged_and_go_on_after_a_resume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = small_config(tmp_path / "run", "trainer.episodes=6", "logger.interval=1")
    clock = iter(range(0, 10**9, 60))
    monkeypatch.setattr("uavrl.training.trainer.time.monotonic", lambda: float(next(clock)))
    first = train(config, create_run(config))
    config.trainer.episodes = 12
    second = train(config, tmp_path / "run", resume=True)
    (file,) = (tmp_path / "run" / "logs").rglob("minutes.csv")
    minutes = [float(row.split(",")[1]) for row in file.read_text().splitlines()]
    assert minutes == sorted(minutes) and len(minutes) >= 10
    assert minutes[0] >= 1.0
    assert 6 < first["minutes"] < minutes[-1] < second["minutes"]
