"""An evaluation that several processes fly: the same tasks, one result, and nothing left behind."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from subprocess import PIPE
from typing import Any

import pytest

from tests.helpers.commands import VALLEY, in_process
from tests.helpers.signals import hearing
from uavrl.cli.evaluate import main as evaluate
from uavrl.cli.processes import as_complete, processes, submit_all
from uavrl.errors import UavrlError

FEW = [*VALLEY, "num_uavs=2", "progress=false"]
ENDLESS = ["policy=failing.Fails", "packages=[failing]", *FEW, "env.max_steps=1000000", "episodes=4", "processes=2"]
FAILS = """
import os, signal
import torch
from uavrl.errors import UavrlError

class Fails:
    def __call__(self, state):
        if HERE:
            AT_ONCE
        return state.set("action", torch.zeros(*state.batch_size, 4))
"""
IN_A_WORKER = "__import__('multiprocessing').parent_process() is not None and state['task'].min() > 0"


def evaluation(folder: Path, *overrides: str, episodes: int = 7) -> dict[str, Any]:
    output = folder / "found.json"
    where = ["policy=straight", *FEW, "env.max_steps=30", "valleys=[3,4,5]"]
    assert in_process(evaluate, *where, f"episodes={episodes}", *overrides, f"output={output}") == 0
    found: dict[str, Any] = json.loads(output.read_text())
    return found


def test_processes_fly_the_same_tasks_with_the_same_ends(tmp_path: Path) -> None:
    """Seven tasks in two shares, and two of them in nine, of which seven have none."""
    one, two = (evaluation(tmp_path, f"processes={count}") for count in (1, 2))
    assert two.pop("processes") == 2 and "processes" not in one
    assert two["outcomes"] == one["outcomes"] and len(set(one["outcomes"])) > 1
    for ours, theirs in zip(two.pop("flights"), one.pop("flights"), strict=True):
        assert ours.keys() == theirs.keys()
        for key, value in ours.items():
            near = value if isinstance(value, str) else pytest.approx(value, rel=1e-4, abs=1e-4)
            assert theirs[key] == near, (ours["task"], key)
    assert two.pop("position_stats")["steps"] == one.pop("position_stats")["steps"]
    for key in ("env", "valleys", "planes", "num_uavs", "overrides", "success", "success_by_valley", "matmul"):
        assert two[key] == one[key], key
    many = evaluation(tmp_path, "processes=9", episodes=2)
    assert (many["processes"], many["num_uavs"], many["outcomes"]) == (2, 1, one["outcomes"][:2])


def test_the_rows_of_a_suite_are_divided_too(tmp_path: Path) -> None:
    what = ["policy=straight", "suite=[static]", "episodes=3", "seed=7", "progress=false"]
    assert in_process(evaluate, *what, "processes=2", f"output={tmp_path / 'two'}") == 0
    assert in_process(evaluate, *what, f"output={tmp_path / 'one'}") == 0
    two, one = (json.loads((tmp_path / name / "suite.json").read_text())["static"] for name in ("two", "one"))
    assert two.pop("processes") == 2 and two["outcomes"] == one["outcomes"]


@pytest.mark.parametrize(
    ("at_once", "told"),
    [
        ("raise UavrlError('Its battery is empty: charge it.')", "uavrl: Its battery is empty: charge it.\n"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "often for want of memory: start it again, with fewer processes.\n"),
    ],
)
def test_an_error_of_one_process_ends_the_others(
    at_once: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "failing.py").write_text(FAILS.replace("HERE", IN_A_WORKER).replace("AT_ONCE", at_once))
    monkeypatch.syspath_prepend(tmp_path)
    begun, output = time.monotonic(), tmp_path / "found.json"
    assert in_process(evaluate, *ENDLESS, "valleys=[3,4,5]", f"output={output}") == 1
    assert capfd.readouterr().err.endswith(told)
    assert not output.exists() and time.monotonic() - begun < 300


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_end_of_a_process_is_noticed_that_the_pool_overlooks(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pool's thread lists the processes whose end it waits for, and only then the last process is started."""
    start = ProcessPoolExecutor._adjust_process_count

    def start_later(pool: ProcessPoolExecutor) -> None:
        time.sleep(1)
        start(pool)

    monkeypatch.setattr(ProcessPoolExecutor, "_adjust_process_count", start_later)
    begun = time.monotonic()

    def look() -> None:
        assert time.monotonic() - begun < 60, "nobody noticed"

    with pytest.raises(UavrlError, match=r"^It was killed\.$"), processes(2, "It was killed.") as pool:
        futures, started = submit_all(pool, time.sleep, {"": [600, 600]})
        os.kill(max(process.pid or 0 for process in started), number)
        time.sleep(0.5 * (number == signal.SIGKILL))  # it ends before or after the first look
        list(as_complete(futures, started, look))


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_evaluation_that_is_stopped_leaves_no_process_and_no_file(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    """Its output ends when all that hold it have ended."""
    (tmp_path / "failing.py").write_text(FAILS.replace("HERE", "True").replace("AT_ONCE", "open('flies', 'w').close()"))
    where = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)])}
    command = [sys.executable, "-m", "uavrl.cli.evaluate", *ENDLESS, "valleys=[3]"]
    with hearing(command, cwd=tmp_path, env=where, stdout=PIPE, stderr=PIPE, text=True) as process:
        deadline = time.monotonic() + 300
        while not (tmp_path / "flies").exists():
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.1)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (code, "", "uavrl: stopped.\n")
    assert sorted(each.name for each in tmp_path.iterdir() if each.suffix != "") == ["failing.py"]
