"""What all commands share: their terminal, their arguments, and what the processes that they start import."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import main as main_command
from uavrl.cli import train as train_command
from uavrl.cli.command import explained
from uavrl.runs.machine import processors
from uavrl_onboard.cli.process import SAFE_PATH, command_process, one_sentence, sentence


@pytest.mark.parametrize("before", [None, "", "1"])
def test_processes_that_a_command_starts_import_nothing_from_the_working_folder(
    monkeypatch: pytest.MonkeyPatch, before: str | None
) -> None:
    monkeypatch.delenv(SAFE_PATH, raising=False)
    if before is not None:
        monkeypatch.setenv(SAFE_PATH, before)
    with command_process():
        assert os.environ[SAFE_PATH] == "1"
    assert os.environ.get(SAFE_PATH) == before


@pytest.mark.parametrize(
    ("error", "told", "code"),
    [("KeyboardInterrupt", "uavrl: stopped.", -signal.SIGINT), ("ValueError(3)", "ValueError: 3", 1)],
)
def test_ctrl_c_while_modules_are_imported_is_told_in_a_sentence(error: str, told: str, code: int) -> None:
    """What a script of this name does before it calls anything of ours; other errors keep their traceback."""
    program = f"import signal, uavrl.cli; signal.signal(signal.SIGINT, signal.default_int_handler); raise {error}"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, ended.stderr.splitlines()[-1]) == (code, told)
    assert ("Traceback" in ended.stderr) == (error != "KeyboardInterrupt")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_command_that_is_ended_says_so_and_cleans_up(
    number: signal.Signals, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    passed: list[int] = []
    before = signal.signal(number, lambda number, _: passed.append(number))
    try:
        with pytest.raises(SystemExit) as end, command_process():
            os.kill(os.getpid(), number)
            time.sleep(0.1)
    finally:
        signal.signal(number, before)
    assert (end.value.code, passed) == (code, [])
    assert capsys.readouterr().err == "uavrl: stopped.\n"


def test_nothing_of_a_torch_that_is_half_loaded_is_told() -> None:
    code = (
        "import logging; from uavrl.cli.logs import configure_logging; configure_logging()\n"
        "logging.getLogger('torch._subclasses.fake_tensor').info('of caches')\n"
        "logging.getLogger('uavrl.training').info('of a run')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "of a run\n"


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "utf-8"])
@pytest.mark.parametrize("errors", ["strict", "surrogateescape"])
def test_every_help_can_be_shown_in_any_encoding(encoding: str, errors: str, monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors=errors)
    monkeypatch.setattr(sys, "stdout", out)
    assert in_process(main_command.main, "pretrain", "--help=all") == 0
    told = out.buffer.getvalue().decode(encoding)  # type: ignore[attr-defined]
    assert ("ABR⁺" if encoding == "utf-8" else "ABR+") in told


def test_an_argument_that_is_no_text_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    told = refused(train_command.main, f"run_dir={tmp_path}/m\udcfcll")
    encoding = sys.getfilesystemencoding()
    assert f"/m?ll' holds letters that are no text in the encoding of this terminal ({encoding})" in told
    assert not list(tmp_path.iterdir())


def test_a_text_is_taken_as_it_is_typed_and_a_list_that_cannot_be_read_is_told(refused: Callable[..., str]) -> None:
    for name in ("müll", "a=1", "runs (1)", "学习"):
        assert f"{name} " in refused(evaluate_command.main, f"run={name}")
    assert refused(evaluate_command.main, "tasks=[1").endswith("write KEY=VALUE, and quotes around special characters.")


@pytest.mark.parametrize("key", ["run", "output", "checkpoint"])
def test_a_tilde_is_the_home_folder(
    key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    from tests.helpers.configs import composed
    from uavrl.config import EvaluateConfig, validate

    config = composed("evaluate")
    config[key] = "~/x"
    assert getattr(validate(config, EvaluateConfig), key) == str(tmp_path / "home/x")
    config[key] = "~nobody-is-called-so/x"
    with pytest.raises(ValueError, match=f"{key} must be a folder, where one that is called so is written ./~nobody"):
        validate(config, EvaluateConfig)


def test_a_full_disk_is_told_with_the_file_and_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit), one_sentence():
        raise OSError(28, "No space left on device", "replay.html")
    told = "replay.html: No space left on device. Check the folder and the space left on its disk.\n"
    assert capsys.readouterr().err == f"uavrl: {told}"


def test_nobody_who_reads_is_no_fault_of_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    monkeypatch.setattr(sys, "stdout", os.fdopen(writer, "w"))
    with pytest.raises(SystemExit) as ended, one_sentence():
        sys.stdout.write("told\n")
        sys.stdout.flush()
    assert ended.value.code == 141
    assert sentence(BrokenPipeError(32, "Broken pipe")) == "Broken pipe"


def test_a_process_of_a_sweep_that_was_killed_says_how_to_go_on() -> None:
    assert "start the same command again" in explained(BrokenProcessPool("A worker process …"), "config")


def test_a_sweep_says_where_it_cannot_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").touch()
    told = refused(train_command.main, "-m", f"run_dir={tmp_path / 'run'}", "seed=0,1")
    assert "runs/sweeps cannot be written" in told and "hydra.sweep.dir=FOLDER" in told


def test_as_many_processors_as_the_process_may_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(6)), raising=False)
    assert processors(tmp_path / "none") == 6
    for text, allowed in {"max 100000": 6, "250000 100000": 3, "50000 100000": 1, "900000 100000": 6}.items():
        (tmp_path / "cpu.max").write_text(text)
        assert processors(tmp_path / "cpu.max") == allowed
