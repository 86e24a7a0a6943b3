"""Locks for what is one for the whole process."""

import os
import threading
from contextlib import suppress


class OneAtATime:
    """A re-entrant lock, as a context manager. A forked child has it free, whichever thread held it in its parent.

    Examples:
        >>> lock = OneAtATime()
        >>> with lock, lock:
        ...     pass
    """

    def __init__(self) -> None:
        self._renew()
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._renew)

    def _renew(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        with suppress(RuntimeError):  # renewed by a fork meanwhile
            self._lock.release()
