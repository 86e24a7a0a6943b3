"""A policy with a memory solves what no other can, and its run is one like all others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.commands import SMALL_EVALUATION, TINY, VALLEY, in_process
from tests.helpers.cue import CONFIG_DIR, TRUSTED
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import export as export_command
from uavrl.cli import replay as replay_command
from uavrl.cli import train as train_command

QUICK = [
    "env=cue",
    "algo.hidden=[32]",
    "algo.batch_size=80",
    "algo.learning_starts=400",
    "algo.actor_lr=1e-3",
    "algo.critic_lr=3e-3",
    "algo.tau=0.02",
    "algo.exploration_noise=0.3",
    "buffer.capacity=20000",
    "trainer.steps=4000",
    "trainer.episodes=100000",
    "trainer.updates_per_step=0.4",
    "trainer.execution=eager",
    "trainer.progress=false",
    "trainer.matmul=mkl",
    "trainer.window=40",
]
GRU = ["recurrent=gru", "recurrent.size=16", "recurrent.burn_in=2", "recurrent.length=4"]


def success_rate(folder: Path, *overrides: str) -> float:
    run, result = f"run={folder / 'run'}", folder / "result.json"
    training = [*CONFIG_DIR, TRUSTED, *QUICK, *overrides, f"run_dir={folder / 'run'}"]
    assert in_process(train_command.main, *training) == 0
    judged = [run, TRUSTED, "episodes=60", f"output={result}", "progress=false"]
    assert in_process(evaluate_command.main, *judged) == 0
    return float(json.loads(result.read_text())["success"]["rate"])


@pytest.mark.parametrize("algo", ["td3", "sac"])
def test_a_cue_at_the_start_is_remembered_by_a_memory(algo: str, tmp_path: Path) -> None:
    """One that remembers nothing acts alike after both cues, and half of the tasks end well at most."""
    assert success_rate(tmp_path, f"algo={algo}", *GRU) > 0.95


def test_a_cue_at_the_start_is_forgotten_without_a_memory(tmp_path: Path) -> None:
    assert success_rate(tmp_path) < 0.65


def test_a_run_with_a_memory_is_evaluated_replayed_and_exported_as_any_other(tmp_path: Path) -> None:
    run, folder = f"run={tmp_path / 'run'}", tmp_path / "policy"
    chosen = ["recurrent=gru", "recurrent.size=8", "recurrent.burn_in=2", "recurrent.length=2", "perception.frames=1"]
    assert in_process(train_command.main, *TINY, *chosen, f"run_dir={tmp_path / 'run'}") == 0
    assert in_process(export_command.main, run, f"output={folder}") == 0
    page = [f"output={tmp_path / 'page.html'}", "task=1", "points=1000", "progress=false"]
    assert in_process(replay_command.main, run, *page) == 0
    outcomes = []
    for number, (policy, guards) in enumerate([(run, "none"), (f"policy={folder}", "none"), (run, "[shield]")]):
        result = tmp_path / f"result{number}.json"
        # The exported network is told the environment of the run by its own keys.
        there = [] if policy == run else [*VALLEY, "env.max_steps=20"]
        told = [f"guards={guards}", f"output={result}", "valleys=[0]", *there, *SMALL_EVALUATION]
        assert in_process(evaluate_command.main, policy, *told) == 0
        flights = json.loads(result.read_text())["flights"]
        outcomes.append([(flight["outcome"], flight["steps"], round(flight["flown"], 2)) for flight in flights])
    assert outcomes[0] == outcomes[1]
