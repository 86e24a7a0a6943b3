"""Validations in a process of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import pytest
import torch

from tests.helpers.runs import SMALL, small_config
from tests.helpers.signals import hearing
from uavrl.config import validate
from uavrl.errors import FlyingEnded, ValidationFailed
from uavrl.losses.networks import NetworkSizes, make_actor
from uavrl.training.build import make_flight
from uavrl.training.run import create_run, train
from uavrl.training.validation import Flight, HereFlier, ProcessFlier

UNSEEN = ["validation=unseen", "validation.interval=60", "validation.tasks=4", "validation.seeds=[7]"]
SIZES = NetworkSizes(state=105, frames=3, actions=4, limit=2.0)


def flight(tmp_path: Path) -> partial[Flight]:
    config = small_config(tmp_path / "unused", "env.max_steps=60", "env.world.goal_radius=6", "env.world.obstacles=0")
    return partial(make_flight, validate(config), SIZES)


def answer(flier: ProcessFlier, seconds: float = 120) -> int | None:
    deadline = time.monotonic() + seconds
    while (found := flier.successes()) is None and time.monotonic() < deadline:
        time.sleep(0.05)
    return found


def broken() -> Flight:
    raise ValueError("the valley\nis full")


def unusable(*_: object) -> Flight:
    return broken()


def test_a_process_of_its_own_counts_what_this_one_counts_and_ends(tmp_path: Path) -> None:
    new_flight, before = flight(tmp_path), active_children()
    torch.manual_seed(3)
    weights = dict(make_actor(validate(small_config(tmp_path / "unused")), SIZES).state_dict())
    here, elsewhere = HereFlier(new_flight), ProcessFlier(new_flight, threads=1)
    state = torch.get_rng_state()
    try:
        began = time.monotonic()
        elsewhere.begin({**weights, "large": torch.zeros(10**6)}, 12, 0)
        assert time.monotonic() - began < 2.0, "it would have waited until the process listens"
        elsewhere.close()
        elsewhere = ProcessFlier(new_flight, threads=1)
        for seed in (1, 2):
            here.begin(weights, 12, seed)
            elsewhere.begin(weights, 12, seed)
            assert elsewhere.successes() is None, "it would have waited"
            assert answer(elsewhere) == here.successes()
        assert torch.equal(torch.get_rng_state(), state)
        assert len(active_children()) == len(before) + 1
    finally:
        elsewhere.close()
        here.close()
    assert active_children() == before


def test_what_it_cannot_fly_and_its_death_are_told_in_a_sentence() -> None:
    flier = ProcessFlier(broken, threads=1)
    flier.begin({}, 1, 0)
    with pytest.raises(ValidationFailed, match=r"validation failed \(ValueError: the valley is full\), and"):
        answer(flier)
    os.kill(flier._process.pid or 0, signal.SIGKILL)
    with pytest.raises(FlyingEnded, match=r"the validation, exit code -9"):
        answer(flier)
    with pytest.raises(FlyingEnded):
        flier.begin({}, 1, 0)
    flier.close()
    flier.close()


def test_a_run_with_another_process_is_validated_and_resumed(tmp_path: Path) -> None:
    before = active_children()
    config = small_config(tmp_path / "run", "collector=async", *UNSEEN, "trainer.steps=3000", "trainer.episodes=5000")
    first = train(config, create_run(config))["validations"]
    assert first and active_children() == before
    config.trainer.steps = 4000
    second = train(config, tmp_path / "run", resume=True)["validations"]
    assert second[: len(first)] == first and active_children() == before


def test_a_run_whose_validation_fails_keeps_what_it_has_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavrl.training.build.make_flight", unusable)
    config = small_config(tmp_path / "run", "collector=async", *UNSEEN, "trainer.episodes=5000")
    with pytest.raises(ValidationFailed, match="the valley is full"):
        train(config, create_run(config))
    assert list((tmp_path / "run").rglob("*.ckpt")) or any((tmp_path / "run" / "checkpoints").iterdir())
    assert active_children() == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_a_run_that_is_stopped(tmp_path: Path, number: signal.Signals) -> None:
    run = tmp_path / "run"
    more = ["collector=async", *UNSEEN, "validation.tasks=2000", "trainer.episodes=500000", f"run_dir={run}"]
    command = [sys.executable, "-m", "uavrl.cli.train", *SMALL, *more]
    with hearing(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 300
        while len(children(process.pid)) < 3:  # the collector's worker, the validation, Python's resource tracker
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.05)
        time.sleep(5.0)  # it flies
        family = children(process.pid)
        process.send_signal(number)
        _, said = process.communicate(timeout=300)
    assert process.returncode == (130 if number == signal.SIGINT else -9)
    if number == signal.SIGINT:  # nobody can clean up, or be silenced, after a SIGKILL
        assert "Traceback" not in said and "leaked" not in said
    deadline = time.monotonic() + 60
    while any(Path(f"/proc/{child}").exists() for child in family):
        assert time.monotonic() < deadline, "a process stays"
        time.sleep(0.1)


def children(parent: int) -> list[int]:
    found = []
    for task in Path(f"/proc/{parent}/task").glob("*/children"):
        found += [int(child) for child in task.read_text().split()]
    return found
