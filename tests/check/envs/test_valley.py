"""The Gymnasium environment in a process that has not loaded it."""

from __future__ import annotations

import subprocess
import sys


def test_gymnasium_finds_it_by_name() -> None:
    """With the name of the module in front, which loads it, and without, once it is loaded."""
    code = """
from gymnasium import make
for name in ("uavrl:uavrl/Valley-v0", "uavrl/Valley-v0"):
    print(make(name, max_steps=2).reset(seed=0)[0].shape)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-2:] == ["(105,)", "(105,)"]
