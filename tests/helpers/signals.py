"""Commands that hear every signal, whoever runs the tests."""

from __future__ import annotations

import sys

_HEAR = """
import os, signal, sys
for each in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
    signal.signal(each, signal.SIG_DFL)
os.execv(sys.argv[1], sys.argv[1:])
"""

HEARING = (sys.executable, "-c", _HEAR)
"""Before a command: shells and ``nohup`` have their background jobs ignore SIGINT and SIGHUP, and these hand that on.

A ``preexec_fn`` would run in a copy of this process, whose other threads may hold a lock, and wait for it without end.
"""
