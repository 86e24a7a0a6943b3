"""Ctrl-C, SIGTERM and kill -9: a run says from where it goes on, and goes on from there."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from pathlib import Path
from subprocess import PIPE

import pytest

from tests.helpers.commands import in_process
from tests.helpers.runs import SMALL, assert_same_run, small_config
from tests.helpers.signals import hearing
from uavrl.cli import train as train_command
from uavrl.runs.checkpoint import how_to_go_on, rotation
from uavrl.runs.episodes import Episode, read_episodes
from uavrl.training.progress import Progress
from uavrl.training.run import create_run, train

EPISODES = ["trainer.episodes=12"]


def kill_at(monkeypatch: pytest.MonkeyPatch, episode: int, number: signal.Signals, times: int = 1) -> None:
    """Sends a signal to this process when an episode has ended, before the updates that follow."""

    def update(self: Progress, episodes: int, *_: object) -> None:
        if episodes == episode:
            for _ in range(times):
                os.kill(os.getpid(), number)

    monkeypatch.setattr(Progress, "update", update)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was left alone."""
    config = small_config(tmp_path_factory.mktemp("whole") / "run", *EPISODES)
    train(config, create_run(config))
    return Path(config.run_dir)


# ---------------------------------------------------------------------- before the first checkpoint


@pytest.fixture
def killed_early(tmp_path: Path) -> Path:
    """What kill -9 leaves while the first checkpoint is written and an artifact is half copied."""
    run_dir = create_run(small_config(tmp_path / "run", *EPISODES))
    (run_dir / "checkpoints/.checkpoint-000000000000.torchrl.stage-1").touch()
    (run_dir / "artifact").mkdir()
    (run_dir / "episodes.csv").write_text(",".join(Episode.header()) + "\n")
    return run_dir


def test_a_run_that_was_killed_before_its_first_checkpoint_is_resumed(whole: Path, killed_early: Path) -> None:
    assert in_process(train_command.main, f"resume={killed_early}") == 0
    assert_same_run(whole, killed_early)
    assert not (killed_early / "artifact").exists()


def test_a_run_that_was_killed_before_its_first_checkpoint_is_started_again(whole: Path, killed_early: Path) -> None:
    assert in_process(train_command.main, *SMALL, *EPISODES, f"run_dir={killed_early}") == 0
    assert_same_run(whole, killed_early)
    assert in_process(train_command.main, *SMALL, *EPISODES, f"run_dir={killed_early}") == 1


# ---------------------------------------------------------------------- Ctrl-C and SIGTERM


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_checkpoint_that_comes_soon_is_waited_for(
    number: signal.Signals,
    code: int,
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    run_dir = tmp_path / "run"
    with monkeypatch.context() as patch:
        kill_at(patch, 2, number)
        assert in_process(train_command.main, *SMALL, *EPISODES, f"run_dir={run_dir}") == code
    flown = len(read_episodes(run_dir / "episodes.csv"))
    assert 2 < flown < 12
    expected = f"uavrl: stopped after episode {flown}, which is saved: resume with uavrl-train resume={run_dir}."
    assert [line for line in capfd.readouterr().err.splitlines() if "stopped" in line] == [expected]
    assert in_process(train_command.main, f"resume={run_dir}") == 0
    assert_same_run(whole, run_dir)


@pytest.mark.parametrize(("interval", "times"), [(10**6, 1), (20, 2)], ids=["too far", "asked twice"])
def test_a_checkpoint_is_not_waited_for_that_is_too_far_or_where_a_person_insists(
    interval: int, times: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    kill_at(monkeypatch, 2, signal.SIGTERM, times)
    overrides = [*SMALL, *EPISODES, f"trainer.checkpoint_interval={interval}", f"run_dir={tmp_path / 'run'}"]
    assert in_process(train_command.main, *overrides) == 143
    err = capfd.readouterr().err
    on = f"uavrl-train resume={tmp_path / 'run'} continues after episode 0 and repeats episodes 1 to 2."
    assert f"uavrl: stopped after episode 2: {on}\n" in err
    assert err.count("stopped") == 1


def test_flights_of_another_process_are_saved_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    kill_at(monkeypatch, 3, signal.SIGINT)
    overrides = [*SMALL, *EPISODES, "collector=async", "trainer.checkpoint_interval=100000"]
    assert in_process(train_command.main, *overrides, f"run_dir={tmp_path / 'run'}") == 130
    assert "uavrl: stopped after episode 3, which is saved: resume with" in capfd.readouterr().err
    assert len(rotation(tmp_path / "run").checkpoints()) == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_ending_that_hangs_is_broken_off_by_the_second_signal(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    passed: list[int] = []

    def hang(_: Progress) -> None:
        for _ in range(9):
            os.kill(os.getpid(), number)
            passed.append(number)

    monkeypatch.setattr(Progress, "close", hang)  # which, unlike a collector's shutdown, no garbage collection calls
    overrides = [*SMALL, "trainer.episodes=2", f"run_dir={tmp_path / 'run'}"]
    assert in_process(train_command.main, *overrides) == 128 + number
    assert passed == [number], "the first one may be that of who asked twice"
    expected = f"uavrl: stopped after episode 2, which is saved: resume with uavrl-train resume={tmp_path / 'run'}."
    assert [line for line in capfd.readouterr().err.splitlines() if "stopped" in line] == [expected]


def test_a_damaged_checkpoint_does_not_hide_that_a_run_was_stopped(whole: Path, tmp_path: Path) -> None:
    run_dir = Path(shutil.copytree(whole, tmp_path / "run"))
    rotation(run_dir).latest().write_bytes(b"")
    assert how_to_go_on(run_dir) == f"stopped: resume with uavrl-train resume={run_dir}."
    trusted = how_to_go_on(run_dir, ["own_parts"])
    assert trusted == f"stopped: resume with uavrl-train resume={run_dir} 'packages=[own_parts]'."


# ---------------------------------------------------------------------- the processes of a suite

SUITE = """
import signal, sys, threading, time
from uavrl_onboard.cli.process import command_process
from uavrl.cli.processes import as_complete, processes, submit_all

def hear():
    time.sleep(0.5)  # until the main thread waits
    signal.pthread_kill(threading.get_ident(), int(sys.argv[1]))

if __name__ == "__main__":
    with command_process(), processes(2, "killed") as pool:
        evaluations, started = submit_all(pool, time.sleep, {"": [600] * 4})
        if sys.argv[1:]:
            threading.Thread(target=hear, daemon=True).start()
        print("begun", flush=True)
        list(as_complete(evaluations, started, lambda: None))
"""


@pytest.mark.parametrize("in_another_thread", [False, True])
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_suite_that_is_ended_leaves_nothing_behind(
    number: signal.Signals, code: int, in_another_thread: bool, tmp_path: Path
) -> None:
    """The system chooses the thread that takes a signal: mostly the main one, but not always."""
    script = tmp_path / "suite.py"
    script.write_text(SUITE, encoding="utf-8")
    told = [str(int(number))] if in_another_thread else []
    with hearing([sys.executable, script, *told], stdout=PIPE, stderr=PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "begun\n"
        if not in_another_thread:
            process.send_signal(number)
        _, err = process.communicate(timeout=60)  # ends when all that hold the pipe have ended
    assert (process.returncode, err) == (code, "uavrl: stopped.\n"), "leaked semaphores were warned of"


# ---------------------------------------------------------------------- a terminal that is closed

ON_A_TERMINAL = """
import fcntl, sys, termios
from uavrl_onboard.cli.process import command_process

fcntl.ioctl(0, termios.TIOCSCTTY, 0)
with command_process():
    try:
        print("begun", flush=True)
        sys.stdin.read()
    finally:
        open("cleaned", "w").close()
        AT_THE_END
"""


@pytest.mark.parametrize("at_the_end", ["pass", "print('what it has', flush=True)", "print('what it has', end='')"])
def test_a_command_whose_terminal_is_closed_cleans_up_and_exits_with_129(at_the_end: str, tmp_path: Path) -> None:
    script, (ours, theirs) = tmp_path / "command.py", os.openpty()
    script.write_text(ON_A_TERMINAL.replace("AT_THE_END", at_the_end), encoding="utf-8")
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    where = {"cwd": tmp_path, "start_new_session": True, "env": buffered}
    with hearing([sys.executable, script], **where, stdin=theirs, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        shown = b""
        while b"begun" not in shown:
            shown += os.read(ours, 1000)
        os.close(ours)
        assert process.wait(60) == 128 + signal.SIGHUP
    assert (tmp_path / "cleaned").exists()
