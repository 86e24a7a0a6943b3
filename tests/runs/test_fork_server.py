"""The server that forks the processes of a command: what it has loaded, and that nothing outlives the command."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from uavrl.runs.fork_server import THREADS, fork_server, forked_processes, start_method

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere processes are not forked")
LOADED = "wave"  # a module of Python's that nothing else here imports


def lives(process: int) -> bool:
    """Whether a process runs: one that has ended and that nobody has waited for does not."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def ends(process: int, seconds: float = 60.0) -> bool:
    until = time.monotonic() + seconds
    while lives(process) and time.monotonic() < until:
        time.sleep(0.1)
    return not lives(process)


def seen() -> dict[str, Any]:
    """What a forked process sees."""
    signals = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    held_back = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP} <= signals
    loaded = LOADED in sys.modules
    return {"server": os.getppid(), "loaded": loaded, "threads": os.environ.get(THREADS), "held back": held_back}


def asked(method: str | None, function: Callable[[], Any] = seen) -> Any:
    """What a function returns in a process."""
    with ProcessPoolExecutor(1, multiprocessing.get_context(method)) as pool:
        return pool.submit(function).result()


def test_processes_have_loaded_what_the_server_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(THREADS, raising=False)
    assert start_method() is None
    with fork_server(LOADED, threads=3):
        assert (start_method(), start_method("cuda")) == ("forkserver", None)
        assert THREADS not in os.environ
        first = asked(start_method())
    assert start_method() is None and not lives(first["server"])
    assert first["server"] != os.getpid()
    assert (first["loaded"], first["threads"], first["held back"]) == (True, "3", True)
    assert not asked("spawn")["loaded"]


def test_each_command_has_a_server_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    servers = []
    for threads in ("1", "2"):
        monkeypatch.setenv(THREADS, threads)
        with fork_server("no_such_module", threads=3):
            servers.append(asked(start_method()))
    assert [each["threads"] for each in servers] == ["1", "2"] and servers[0]["server"] != servers[1]["server"]


def test_libraries_fork_their_processes_where_they_can() -> None:
    before = multiprocessing.get_start_method(allow_none=True)
    with forked_processes("cpu"):
        assert multiprocessing.get_start_method(allow_none=True) == before
    with fork_server(LOADED):
        with forked_processes("cuda"):
            assert multiprocessing.get_start_method(allow_none=True) == before
        with pytest.raises(KeyboardInterrupt), forked_processes("cpu"):
            assert multiprocessing.get_start_method() == "forkserver"
            raise KeyboardInterrupt
        assert multiprocessing.get_start_method(allow_none=True) == before


def test_it_ends_at_once_while_it_still_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "endless.py").write_text(
        "import os, time\nopen('server', 'w').write(str(os.getpid()))\ntime.sleep(600)"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KeyboardInterrupt), fork_server("endless"):
        while not (tmp_path / "server").exists() or not (tmp_path / "server").read_text():
            time.sleep(0.05)
        raise KeyboardInterrupt
    assert not lives(int((tmp_path / "server").read_text()))


def test_a_machine_without_room_for_it_starts_processes_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        raise BlockingIOError("Resource temporarily unavailable")

    monkeypatch.setattr("multiprocessing.forkserver.ensure_running", fails)
    with fork_server(LOADED):
        assert start_method() is None


KILLED = """
import os, time
from uavrl.cli.processes import processes
from uavrl.runs.fork_server import fork_server

if __name__ == "__main__":
    with fork_server("wave"), processes(1) as pool:
        print(pool.submit(os.getpid).result(), pool.submit(os.getppid).result(), flush=True)
        pool.submit(time.sleep, 600)
        time.sleep(600)
"""


def test_server_and_process_end_with_a_command_that_is_killed(tmp_path: Path) -> None:
    (tmp_path / "killed.py").write_text(KILLED)
    root = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(
        [sys.executable, tmp_path / "killed.py"], env=root, stdout=subprocess.PIPE, text=True
    ) as command:
        assert command.stdout is not None
        process, server = map(int, command.stdout.readline().split())
        assert lives(process) and lives(server) and server != command.pid
        command.kill()
        assert ends(process) and ends(server)
