"""The memory of one cycle's arrays serves the next one's."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import numpy as np
from uavrl_onboard.flight.memory import keep_memory
from uavrl_onboard.lidar.coverage import Coverage
if sys.argv[1] == "keep":
    keep_memory()
points, coverage = np.random.default_rng(0).normal(size=(27_000, 3)).astype(np.float32), Coverage()
for _ in range(5):
    coverage.add(points)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    coverage.add(points)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have no such threshold")
def test_a_cycle_takes_no_memory_from_the_system_that_the_last_one_freed() -> None:
    gives, keeps = (
        int(subprocess.run([sys.executable, "-c", FAULTS, how], check=True, capture_output=True, text=True).stdout)
        for how in ("give", "keep")
    )
    assert gives > 500 and keeps < gives / 10
