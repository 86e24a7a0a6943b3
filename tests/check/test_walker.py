"""A whole training of the bipedal walker: what it records, what it stores, and how it goes on."""

from __future__ import annotations

import itertools
import shutil
from pathlib import Path

import pytest

from tests.helpers.runs import ENHANCED, assert_same_run, walker_config
from uavrl.buffers import FailureBias
from uavrl.runs.checkpoint import rotation
from uavrl.runs.episodes import read_episodes
from uavrl.training.run import create_run, train
from uavrl.training.update import ActorCriticStepper


def test_a_resumed_run_with_both_enhancers_is_bit_identical(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole/run", tmp_path / "cut/run"  # the logger names its folder by the last part
    settings = ["trainer.episodes=12", "logger.interval=1", *ENHANCED]
    config = walker_config(whole, *settings)
    train(config, create_run(config))
    shutil.copytree(whole, cut)
    later = rotation(cut).checkpoints()[2:]
    assert len(later) >= 2
    for checkpoint in later:
        checkpoint.unlink()
    train(walker_config(cut, *settings), cut, resume=True)
    assert_same_run(whole, cut)
    logged = {log.stem: log.read_text().splitlines() for log in (whole / "logs").rglob("*.csv")}
    assert float(logged["buffer_left_out"][-1].split(",")[-1]) > 0
    for said in ("lifeguard_penalty", "fork_gate"):
        assert max(float(line.split(",")[-1]) for line in logged[said]) > 0, said
    outcomes = {episode.outcome for episode in read_episodes(whole / "episodes.csv")}
    assert outcomes == {"collided", "timed_out"}


def test_the_actor_waits_after_a_walk_that_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The walks from the fifth on are left out: three updates come after each, of the critics alone."""
    config = walker_config(
        tmp_path / "run", "trainer.episodes=8", "buffer=failure_biased", "buffer.updates_when_left_out=3"
    )
    walks, actor_learns = itertools.count(1), []
    step = ActorCriticStepper.step
    monkeypatch.setattr(FailureBias, "admits", lambda *_: next(walks) < 5)
    monkeypatch.setattr(
        ActorCriticStepper, "step", lambda self, *batch: actor_learns.append(self.actor_learns) or step(self, *batch)
    )
    train(config, create_run(config))
    assert actor_learns[0] and actor_learns[-13:] == [True] + [False] * 12
