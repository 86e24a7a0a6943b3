"""Nothing of somebody else's is removed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from tests.helpers.runs import SMALL
from uavrl.cli import train as train_command
from uavrl.cli.errors import one_sentence
from uavrl.errors import FolderTaken, Stopped
from uavrl.runs.files import removed_on_failure


@pytest.mark.parametrize("mistake", [[], ["backward_reward=abr_plus", "backward_reward.artifact=/nowhere"]])
@pytest.mark.parametrize("name", ["config.yaml", "artifact/weights.bin"])
def test_a_folder_that_is_no_run_keeps_its_files(tmp_path: Path, name: str, mistake: list[str]) -> None:
    precious = tmp_path / "mine" / name
    precious.parent.mkdir(parents=True)
    precious.write_text("mine")
    assert in_process(train_command.main, *SMALL, *mistake, f"run_dir={tmp_path / 'mine'}") == 1
    assert precious.read_text() == "mine"


def test_the_folder_of_another_process_stays(tmp_path: Path) -> None:
    run = tmp_path / "run"
    with pytest.raises(FolderTaken), removed_on_failure(run, "checkpoint*"):
        run.mkdir()  # the other process, which is still building
        raise FolderTaken("Another process trains there.")
    assert run.exists()


def test_a_stop_is_told_once_however_deep(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end, one_sentence(), one_sentence(), one_sentence():
        raise Stopped("stopped after episode 3.", 15)
    assert end.value.code == 143
    assert capsys.readouterr().err == "uavrl: stopped after episode 3.\n"
