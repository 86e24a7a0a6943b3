"""One process trains in a run folder at a time: on this machine, or on another one that shares the folder."""

import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread

from uavrl.errors import FolderTaken, UavrlError, extras
from uavrl.runs.names import HOLDER, LOCK
from uavrl.runs.trust import check_links

with extras():
    from filelock import FileLock, Timeout

BEAT = 15.0  # s between two signs of life
GONE = 120.0  # s without one after which a holder on another machine is taken for dead


@contextmanager
def run_lock(run_dir: Path) -> Iterator[None]:
    """Keeps every other process out of a run folder; within this process it can be nested.

    Not every shared folder hands a file system's lock on to other machines, so its holder also touches a file there
    every ``BEAT`` seconds.
    """
    with _locked(run_dir) as nested:
        if nested:
            yield
            return
        with _heartbeat(run_dir / HOLDER):
            yield


def is_locked(run_dir: Path) -> bool:
    """Whether another process trains in a run folder; of one that begins in this moment, its sign of life is left."""
    if not run_dir.is_dir():
        return False
    try:
        with _locked(run_dir):
            return False
    except FolderTaken:
        return True


@contextmanager
def _locked(run_dir: Path) -> Iterator[bool]:
    """Locks a folder that nobody else holds, without a sign of life; gives whether this process held it before."""
    check_links(run_dir, (LOCK, HOLDER))  # the first that are written: callers look at the rest of the folder later
    lock = FileLock(run_dir / LOCK, blocking=False, is_singleton=True)
    try:
        lock.acquire()
    except Timeout:
        raise _taken(run_dir) from None
    except OSError as error:
        raise UavrlError(
            f"The folder {run_dir} cannot be written ({error.strerror}): choose another, or work on a copy."
        ) from error
    try:
        nested = lock.lock_counter > 1
        if not nested and _held_elsewhere(run_dir):
            raise _taken(run_dir)
        yield nested
    finally:
        lock.release()


def _taken(run_dir: Path) -> FolderTaken:
    holder = _holder(run_dir)
    who = f" (process {holder['pid']} on {holder['host']})" if {"pid", "host"} <= holder.keys() else ""
    return FolderTaken(f"Another process{who} trains in {run_dir}: wait until it ends, or stop it.")


def _holder(run_dir: Path) -> dict[str, object]:
    try:
        held = json.loads((run_dir / HOLDER).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return held if isinstance(held, dict) else {}


def _held_elsewhere(run_dir: Path) -> bool:
    """Whether another machine's process was alive lately; both times are the file system's, whose clock they share."""
    if _holder(run_dir).get("host", platform.node()) == platform.node():
        return False  # here the lock would have told
    os.utime(run_dir / LOCK)
    with suppress(OSError):
        return (run_dir / LOCK).stat().st_mtime - (run_dir / HOLDER).stat().st_mtime < GONE
    return False


@contextmanager
def _heartbeat(holder: Path) -> Iterator[None]:
    holder.write_text(json.dumps({"host": platform.node(), "pid": os.getpid()}), encoding="utf-8")
    ended = Event()

    def beat() -> None:
        while not ended.wait(BEAT):
            with suppress(OSError):
                os.utime(holder)

    thread = Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        holder.unlink(missing_ok=True)
