"""Processes that need not load PyTorch: a server loads it while the command does, and forks itself for each of them.

It is Python's own, :mod:`multiprocessing.forkserver`. Where there is none, processes are started as before.
"""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from types import MethodType
from typing import Any, cast

from uavrl.runs.interrupts import interrupts_held_back

THREADS = "OMP_NUM_THREADS"  # that NumPy, SciPy and PyTorch use, which they read when they are loaded
_running = False


@contextmanager
def fork_server(module: str, threads: int | None = None) -> Iterator[None]:
    """Meanwhile a server runs that imports ``module`` at once; it ends with this context, and with this process.

    Only on Linux, since on macOS a fork of a process that has loaded such libraries may crash. End the processes that
    it has forked before the context ends.

    Args:
        module: what the processes need. Importing it must not start a thread, use CUDA or fail.
        threads: of NumPy, SciPy and PyTorch, unless the environment says otherwise; None: as they choose.
    """
    global _running
    if sys.platform != "linux" or _running:
        yield
        return
    forkserver.set_forkserver_preload([module])
    try:
        with suppress(OSError):
            resource_tracker.ensure_running()  # starting it later would let interrupts through again
            with interrupts_held_back(), threads_set(threads):  # inherited: the command ends its processes
                forkserver.ensure_running()
                _running = True
        yield
    finally:
        if _running:
            _running = False
            _stop()


def _stop() -> None:
    """Ends the server, also while it still imports."""
    server: Any = cast(MethodType, forkserver.ensure_running).__self__
    if server._forkserver_pid is not None:
        with suppress(ProcessLookupError):
            os.kill(server._forkserver_pid, signal.SIGKILL)
        server._stop()


def start_method(device: str = "cpu") -> str | None:
    """How to start a process that computes on a device: forked by the server, or None where there is none.

    A process that was forked cannot use CUDA reliably.
    """
    return "forkserver" if _running and device == "cpu" else None


@contextmanager
def forked_processes(device: str) -> Iterator[None]:
    """Has libraries that ask for Python's start method let the server fork their processes, where it can."""
    before, method = multiprocessing.get_start_method(allow_none=True), start_method(device)
    if method is not None:
        multiprocessing.set_start_method(method, force=True)
    try:
        yield
    finally:
        if method is not None:
            multiprocessing.set_start_method(before, force=True)


@contextmanager
def threads_set(threads: int | None) -> Iterator[None]:
    """Processes that start meanwhile compute with so many threads, unless the environment says otherwise."""
    before = os.environ.get(THREADS)
    if before is not None or threads is None:
        yield
        return
    os.environ[THREADS] = str(threads)
    try:
        yield
    finally:
        del os.environ[THREADS]
