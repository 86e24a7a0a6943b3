"""A mark for tests that measure this machine: its clock, as a sensor or an autopilot goes by it, or its memory.

It is for those, too, that wait for a browser. A machine that has much else to do fails them for a while, and a fault
fails them each time: they get three tries, of which the later ones wait for a core that is free.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

measured = pytest.mark.flaky(reruns=2, reruns_delay=3)
_TIMES = Path("/proc/stat")


def wait_for_a_core(most: float = 120.0, times: Path = _TIMES) -> bool:
    """Wait until a core has been idle for a second, at most so many seconds; tell whether one was.

    Where the system keeps no times of its processors, it does not wait.
    """
    ends = time.monotonic() + most
    while times.is_file() and time.monotonic() < ends:
        before = times.read_text(encoding="ascii")
        time.sleep(1.0)
        if idle_cores(before, times.read_text(encoding="ascii"), os.cpu_count() or 1) > 0.9:
            return True
    return False


def idle_cores(before: str, after: str, cores: int) -> float:
    """How many cores were idle between two readings of ``/proc/stat``."""
    first, last = ([int(ticks) for ticks in text.splitlines()[0].split()[1:9]] for text in (before, after))
    spent = [end - begin for begin, end in zip(first, last, strict=True)]
    return cores * (spent[3] + spent[4]) / max(sum(spent), 1)
