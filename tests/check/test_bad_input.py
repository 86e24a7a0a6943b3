"""Runs whose newest checkpoint or last episodes are lost are trained on from an older one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.commands import SMALL_EVALUATION, in_process, newest
from tests.helpers.damage import flip_in_the_networks, halve
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import train as train_command


@pytest.mark.parametrize("damage", [halve, flip_in_the_networks], ids=lambda d: d.__name__)
def test_a_run_goes_back_to_the_checkpoint_before_a_damaged_one(
    damage: Callable[[Path], None], finished: Path, run_dir: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = newest(run_dir)
    damage(path)
    damaged = path.read_bytes()
    assert in_process(train_command.main, f"resume={run_dir}") == 0
    told = capfd.readouterr().err
    assert f"The checkpoint {path} is damaged" in told and "goes back to the one before, after episode 0" in told
    assert path.with_name(f"unused-{path.name}").read_bytes() == damaged
    assert (run_dir / "episodes.csv").read_bytes() == (finished / "episodes.csv").read_bytes()
    assert in_process(evaluate_command.main, f"run={run_dir}", *SMALL_EVALUATION) == 0


def test_lost_episodes_send_a_run_back_to_a_checkpoint_that_knows_none_of_them(
    finished: Path, run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, rows = newest(run_dir), (run_dir / "episodes.csv").read_text().splitlines(keepends=True)
    (run_dir / "episodes.csv").write_text("".join(rows[:3]))
    assert in_process(train_command.main, f"resume={run_dir}") == 0
    lost = f"The checkpoint {path} follows episode 4, and {run_dir / 'episodes.csv'} has lost those after 2."
    told = capsys.readouterr().err
    assert lost in told and "goes back to the one before, after episode 0" in told
    assert (run_dir / "episodes.csv").read_bytes() == (finished / "episodes.csv").read_bytes()
