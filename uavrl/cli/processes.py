"""Processes that fly for a command."""

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.process import BaseProcess
from queue import Empty, SimpleQueue
from typing import Any

from uavrl.cli.logs import configure_logging
from uavrl.errors import UavrlError

SPAWN = multiprocessing.get_context("spawn")
THREADS = "OMP_NUM_THREADS"  # that NumPy, SciPy and PyTorch use, which they read when they are loaded
EVERY = 1.0  # s, at the latest, between two looks at what has ended: a signal wakes only the thread that it comes to
_counters: list[Any] = []  # of a process that flies, the one of tasks that have ended


@contextmanager
def processes(count: int, killed: str, ended: Any = None, *, threads: int = 1) -> Iterator[ProcessPoolExecutor]:
    """So many processes, which end with this one, and at once on an error and on Ctrl-C.

    They count the tasks that have ended in ``ended``, a shared integer, and compute with ``threads`` threads each,
    unless the environment of the command says otherwise.

    Raises:
        UavrlError: with the sentence ``killed``, when one of them was killed.
    """
    given = os.environ.get(THREADS)
    os.environ.setdefault(THREADS, str(threads))
    pool = ProcessPoolExecutor(count, SPAWN, _begin, (ended,))
    try:
        yield pool
    except BaseException as error:
        for process in multiprocessing.active_children():
            process.kill()
        if isinstance(error, BrokenProcessPool):
            raise UavrlError(killed) from error
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        if given is None:
            del os.environ[THREADS]


def counter() -> Any:
    """An integer that processes share."""
    return SPAWN.Value("q", 0)


def value_of(ended: Any) -> int:
    """The value of a shared integer, also where a process was killed while it was counting."""
    return int(ended.get_obj().value)


def count_task() -> None:
    """Count one more task that has ended, in a process of :func:`processes`."""
    (ended,) = _counters
    with ended.get_lock():
        ended.value += 1


def submit_all(
    pool: ProcessPoolExecutor, call: Callable[[Any], Any], jobs: Mapping[str, Sequence[Any]]
) -> tuple[dict[str, list[Future[Any]]], set[BaseProcess]]:
    """Let a pool of :func:`processes` do jobs; return their futures by name, and the processes that the pool started.

    A pool overlooks the end of a process that it starts while its thread begins to wait, so others must look, too.
    """
    futures: dict[str, list[Future[Any]]] = {name: [] for name in jobs}
    started: set[BaseProcess] = set()
    for name, job in ((name, job) for name, each in jobs.items() for job in each):
        futures[name].append(pool.submit(call, job))
        started.update(multiprocessing.active_children())
    return futures, started


def as_complete(
    futures: Mapping[str, Sequence[Future[Any]]], started: Collection[BaseProcess], meanwhile: Callable[[], None]
) -> Iterator[tuple[str, list[Any]]]:
    """Yield each name with the results of its futures when all of these are there; the first error ends all.

    Args:
        futures: of a pool of :func:`processes`, by the name of what they make together.
        started: processes that must not end before all results are there.
        meanwhile: called at each look.

    Raises:
        UavrlError: with the sentence of a process, after the name, where it has one.
        BrokenProcessPool: when a process was killed.
    """
    pending = {name: list(each) for name, each in futures.items()}
    done = SimpleQueue[Future[Any]]()
    for each in pending.values():  # `concurrent.futures.wait` takes the futures' locks, which a signal can leave taken
        for future in each:
            future.add_done_callback(done.put)
    while pending:
        with suppress(Empty):
            done.get(timeout=EVERY)
        meanwhile()
        for name, each in list(pending.items()):
            try:
                found = [future.result() for future in each if future.done()]
            except UavrlError as error:
                raise UavrlError(f"{name}: {error}" if name else str(error)) from error
            if len(found) == len(each):
                del pending[name]
                yield name, found
        if pending and any(process.exitcode is not None for process in started):
            raise BrokenProcessPool("A process has ended that had something to do.")


def _begin(ended: Any) -> None:
    """Prepare a process that flies."""
    begin_worker()
    _counters[:] = [ended]


def begin_worker() -> None:
    """Prepare a process that flies for a command: its log, and its end with that command."""
    configure_logging()
    logging.getLogger().setLevel(logging.WARNING)

    def end_with_parent() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os.kill(os.getpid(), signal.SIGKILL)  # nobody waits for its result

    threading.Thread(target=end_with_parent, daemon=True).start()
