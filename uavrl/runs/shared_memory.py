"""Shared memory, which containers make small: which errors come from it, and what the user can do."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from uavrl.errors import UavrlError

FOLDER = Path("/dev/shm")
REMEDY = "Give it more room: in Docker start the container with --shm-size=1g; elsewhere check that it is mounted."
_SMALL = 2**26  # bytes: what Docker gives a container
_NEARLY_FULL = 2**20


class SharedMemoryError(UavrlError):
    """Processes and their locks found no room in shared memory, however much is left on the disk."""

    def __init__(self, cause: BaseException) -> None:
        reason = getattr(cause, "strerror", None) or "No space left on device"
        super().__init__(
            f"The shared memory in {FOLDER} cannot be used ({reason}{_free()}). It is not on the disk of the run. "
            f"{REMEDY}"
        )


@contextmanager
def shared_memory_explained() -> Iterator[None]:
    """Turns what Python or PyTorch raise when shared memory has no room into a sentence.

    Raises:
        SharedMemoryError: in place of that error.
    """
    try:
        yield
    except (OSError, RuntimeError) as error:
        if not _is_of_shared_memory(error):
            raise
        raise SharedMemoryError(error) from error


def hint_of_shared_memory() -> str:
    """A sentence for the end of a message about a process that died, where little shared memory may be the cause."""
    try:
        total, _, free = shutil.disk_usage(FOLDER)
    except OSError:
        return ""
    if total > _SMALL and free > _NEARLY_FULL:
        return ""
    return f" If it lacked shared memory: {FOLDER} has {_megabytes(total)}. {REMEDY}"


def _is_of_shared_memory(error: OSError | RuntimeError) -> bool:
    """Whether PyTorch names shared memory, or an error without a file comes from one of Python's semaphores."""
    if isinstance(error, RuntimeError):
        return "shared memory" in str(error) and "No space left" in str(error)
    return error.filename is None and _innermost_module(error.__traceback__) in (
        "multiprocessing.synchronize",
        "joblib.externals.loky.backend.synchronize",
    )


def _innermost_module(traceback: TracebackType | None) -> str | None:
    module = None
    while traceback is not None:
        module, traceback = traceback.tb_frame.f_globals.get("__name__"), traceback.tb_next
    return module


def _free() -> str:
    try:
        total, _, free = shutil.disk_usage(FOLDER)
    except OSError:
        return ""
    return f"; {_megabytes(free)} of {_megabytes(total)} are free"


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.3f} MB" if size < 1e6 else f"{size / 1e6:,.0f} MB"
