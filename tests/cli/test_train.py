"""A training from the command line: what it says of a run that learns nothing, and of a full disk."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.helpers.commands import TINY, in_process
from uavrl.cli import train as train_command


@pytest.mark.parametrize(("learning_starts", "warned"), [(500, True), (0, False)])
def test_a_run_that_learns_nothing_says_so_first_and_last(
    learning_starts: int, warned: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    overrides = [*TINY, f"run_dir={tmp_path / 'run'}", f"algo.learning_starts={learning_starts}"]
    assert in_process(train_command.main, *overrides) == 0
    told = capfd.readouterr().err
    assert ("algo.learning_starts=500: nothing is learned before" in told) == warned
    assert ("Nothing was learned: the run ended after" in told) == warned


def test_a_full_disk_names_the_file_and_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    run_dir = tmp_path / "run"
    sentence = refused(train_command.main, *TINY, f"run_dir={run_dir}")
    assert f"{run_dir / 'episodes.csv'} cannot be written (No space left on device)" in sentence
    assert f"resume with uavrl-train resume={run_dir}" in sentence
    monkeypatch.undo()
    assert in_process(train_command.main, f"resume={run_dir}") == 0


def test_a_checkpoint_is_not_begun_where_it_has_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    """What tensordict maps into memory would end the process by SIGBUS."""
    left = iter([10**9, 10**9, *[10_000] * 9])
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=next(left)))
    run_dir = tmp_path / "run"
    sentence = refused(train_command.main, *TINY, f"run_dir={run_dir}", "trainer.episodes=50")
    assert f"{run_dir} cannot be written" in sentence and "MB are needed and 0.0 MB are left" in sentence
    assert f"resume with uavrl-train resume={run_dir}" in sentence
    assert len(list((run_dir / "checkpoints").iterdir())) == 2
