"""One process at a time trains in a run folder, on whichever machine it is."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest

from tests.helpers.commands import TINY, in_process
from uavrl.cli import train as train_command
from uavrl.errors import FolderTaken, UavrlError
from uavrl.runs import lock as claim
from uavrl.runs.lock import GONE, HOLDER, LOCK, is_locked, run_lock


def elsewhere(folder: Path, age: float) -> None:
    """What a process on another machine leaves, ``age`` seconds after its last sign of life."""
    path = folder / HOLDER
    path.write_text(json.dumps({"host": "another-machine", "pid": 7}))
    now = time.time()
    os.utime(path, (now - age, now - age))


def test_a_process_that_lives_on_another_machine_is_waited_for(tmp_path: Path) -> None:
    elsewhere(tmp_path, age=GONE / 2)
    with pytest.raises(FolderTaken, match=r"process 7 on another-machine\) trains in .*: wait"), run_lock(tmp_path):
        pass
    assert json.loads((tmp_path / HOLDER).read_text())["pid"] == 7, "its sign is left"


def test_the_folder_of_a_machine_that_died_is_taken_over(tmp_path: Path) -> None:
    elsewhere(tmp_path, age=2 * GONE)
    with run_lock(tmp_path):
        assert json.loads((tmp_path / HOLDER).read_text())["pid"] == os.getpid()
    assert not (tmp_path / HOLDER).exists()


def test_a_look_whether_a_folder_is_held_leaves_the_signs_of_its_holder(tmp_path: Path) -> None:
    """Where a lock does not reach other machines, one of them may write its sign while this one looks."""
    for age, held in ((GONE / 2, True), (2 * GONE, False)):
        elsewhere(tmp_path, age=age)
        before = (tmp_path / HOLDER).stat().st_mtime_ns
        assert is_locked(tmp_path) is held
        assert (tmp_path / HOLDER).stat().st_mtime_ns == before
        assert json.loads((tmp_path / HOLDER).read_text())["pid"] == 7
    assert not is_locked(tmp_path / "nowhere") and not (tmp_path / "nowhere").exists()
    with run_lock(tmp_path):
        pass


def test_a_damaged_sign_of_a_killed_process_here_is_no_hindrance(tmp_path: Path) -> None:
    for damaged in ("", "[]", json.dumps({"host": os.uname().nodename, "pid": 1})):
        (tmp_path / HOLDER).write_text(damaged)
        with run_lock(tmp_path):
            assert (tmp_path / LOCK).exists()


def test_whoever_holds_a_folder_shows_signs_of_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claim, "BEAT", 0.01)
    with run_lock(tmp_path):
        os.utime(tmp_path / HOLDER, (0, 0))
        until = time.monotonic() + 60
        while (tmp_path / HOLDER).stat().st_mtime < 1 and time.monotonic() < until:
            time.sleep(0.01)
        assert (tmp_path / HOLDER).stat().st_mtime > 1


@pytest.mark.parametrize("name", [LOCK, HOLDER])
def test_nothing_is_written_through_a_planted_link(name: str, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("untouched")
    run = tmp_path / "run"
    run.mkdir()
    (run / name).symlink_to(tmp_path / "mine")
    with pytest.raises(UavrlError, match=rf"/{name} is a link that leads out of"), run_lock(run):
        pass
    assert (tmp_path / "mine").read_text() == "untouched"
    assert [path.name for path in run.iterdir()] == [name]


@pytest.mark.parametrize("mode", [[], ["-m"]])
def test_a_training_is_refused_before_it_writes_through_a_link(
    mode: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").write_text("untouched")
    run = tmp_path / "run"
    run.mkdir()
    (run / HOLDER).symlink_to(tmp_path / "mine")
    monkeypatch.setattr("uavrl.training.sweep.run_folder", lambda *_: run)
    assert in_process(train_command.main, *mode, *TINY, f"run_dir={run}", f"hydra.sweep.dir={tmp_path / 'sweep'}") == 1
    assert "is a link that leads out of" in capfd.readouterr().err
    assert (tmp_path / "mine").read_text() == "untouched"
