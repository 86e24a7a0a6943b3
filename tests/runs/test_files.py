"""Nothing of somebody else's is removed."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from tests.helpers.runs import SMALL
from uavrl.cli import train as train_command
from uavrl.errors import FolderTaken, Stopped, UavrlError
from uavrl.runs.folders import made_folder
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.files import writable


@pytest.mark.parametrize("mistake", [[], ["backward_reward=abr_plus", "backward_reward.artifact=/nowhere"]])
@pytest.mark.parametrize("name", ["config.yaml", "artifact/weights.bin"])
def test_a_folder_that_is_no_run_keeps_its_files(tmp_path: Path, name: str, mistake: list[str]) -> None:
    precious = tmp_path / "mine" / name
    precious.parent.mkdir(parents=True)
    precious.write_text("mine")
    assert in_process(train_command.main, *SMALL, *mistake, f"run_dir={tmp_path / 'mine'}") == 1
    assert precious.read_text() == "mine"


def test_the_folder_of_another_process_and_what_is_worth_keeping_stay(tmp_path: Path) -> None:
    run = tmp_path / "run"
    with pytest.raises(FolderTaken), made_folder(run, "checkpoint*"):
        raise FolderTaken("Another process trains there.")
    assert run.exists()
    with pytest.raises(ValueError), made_folder(tmp_path / "kept", "checkpoint*"):
        (tmp_path / "kept/checkpoint").touch()
        raise ValueError
    assert (tmp_path / "kept/checkpoint").exists()


def test_each_of_several_that_begin_at_once_gets_a_folder_of_its_own(tmp_path: Path) -> None:
    wanted = tmp_path / "runs/2026-01-01_static"

    def made(_: int) -> Path:
        with made_folder(wanted, "checkpoint*", another=True) as folder:
            return folder

    with ThreadPoolExecutor(8) as pool:
        folders = list(pool.map(made, range(8)))
    assert sorted(folder.name for folder in folders) == [
        wanted.name,
        *(f"{wanted.name}_{number}" for number in range(2, 9)),
    ]
    with made_folder(wanted, "checkpoint*") as folder:
        assert folder == wanted


def test_what_was_made_is_removed_where_it_fails_and_what_was_there_stays(tmp_path: Path) -> None:
    for folder, left in ((tmp_path / "a/b/run", []), (tmp_path / "mine", ["mine"])):
        if left:
            folder.mkdir()
        with pytest.raises(ValueError), made_folder(folder, "checkpoint*", another=False):
            raise ValueError
        assert [path.name for path in tmp_path.iterdir()] == left
    (tmp_path / "file").touch()
    with pytest.raises(UavrlError, match="cannot be written"), made_folder(tmp_path / "file/run", "checkpoint*"):
        pass


def test_a_stop_is_told_once_however_deep(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end, one_sentence(), one_sentence(), one_sentence():
        raise Stopped("stopped after episode 3.", 15)
    assert end.value.code == 143
    assert capsys.readouterr().err == "uavrl: stopped after episode 3.\n"


def test_no_file_takes_the_place_of_a_device_or_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path(os.devnull)):
        with pytest.raises(UavrlError, match=f"{path} cannot be written .it is a device or a pipe, not a file.: "):
            writable(path)
    assert pipe.is_fifo() and Path(os.devnull).is_char_device()
    with pytest.raises(UavrlError, match=f"{os.devnull} is no folder"):
        writable(Path(os.devnull, "page.html"))


def test_no_file_takes_the_place_of_the_link_to_standard_output(tmp_path: Path) -> None:
    """Where that goes into a file it is no device."""
    program = "from pathlib import Path; from uavrl_onboard.files import writable; writable(Path('/dev/stdout'))"
    with (tmp_path / "out").open("w") as out:
        ended = subprocess.run(
            [sys.executable, "-c", program], stdout=out, stderr=subprocess.PIPE, text=True, check=False
        )
    assert "/dev/stdout cannot be written (it is a device or a pipe, not a file)" in ended.stderr
    assert Path("/dev/stdout").is_symlink()


def test_a_name_that_the_system_refuses_is_told_with_what_to_choose(tmp_path: Path) -> None:
    """Looking for a file among its folders ends in the same error."""
    path = tmp_path / ("x" * 300) / "page.html"
    with pytest.raises(UavrlError, match=r"cannot be written .File name too long.: choose another with output=FILE"):
        writable(path)
    with pytest.raises(UavrlError, match=r"File name too long.: choose another with run_dir"), made_folder(path, "*"):
        pass


def test_a_file_among_the_folders_of_a_path_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file/page.html", tmp_path / "file/deeper/page.html"):
        told = f"{path} cannot be written .{tmp_path / 'file'} is no folder.: choose"
        with pytest.raises(UavrlError, match=told):
            writable(path)
        with pytest.raises(UavrlError, match=told), made_folder(path, "checkpoint*"):
            pass
