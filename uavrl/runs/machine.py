"""How many processors this process may use."""

import math
import os
from pathlib import Path

CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")  # of a container, in µs of a processor's time per period


def processors(quota: Path = CPU_QUOTA) -> int:
    """The processors that this process may use, which can be fewer than the machine has."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if quota.is_file():
        share, _, period = quota.read_text(encoding="utf-8").partition(" ")
        if share.isdigit():
            allowed = min(allowed, math.ceil(int(share) / int(period)))
    return max(allowed, 1)
