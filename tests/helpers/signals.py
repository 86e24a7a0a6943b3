"""Commands that hear every signal, whoever runs the tests, and that end with them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

_HEAR = """
import ctypes, os, signal, sys
for each in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
    signal.signal(each, signal.SIG_DFL)
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
os.execv(sys.argv[1], sys.argv[1:])
"""

_HEARING = (sys.executable, "-c", _HEAR)
"""Before a command: shells and ``nohup`` have their background jobs ignore SIGINT and SIGHUP, and these hand that on.

A ``preexec_fn`` would run in a copy of this process, whose other threads may hold a lock, and wait for it without end.
"""


@contextmanager
def hearing(command: Sequence[Any], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Starts a command that hears SIGHUP, SIGINT and SIGTERM; at the end of the block it is killed."""
    with subprocess.Popen([*_HEARING, *command], **options) as process:
        try:
            yield process
        finally:
            process.kill()  # which does nothing to one that has ended
