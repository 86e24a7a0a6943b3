"""What the server of a command's processes loads: nothing that a fork would break."""

import os
import subprocess
import sys

LOADS = """
import os
{before}
import uavrl.cli.preloaded
import sys
assert ("uavrl.training.build" in sys.modules) == {loads}, "loaded"
"""
FORKS = """
import numpy as np, torch
assert len(os.listdir("/proc/self/task")) == 1, "threads"
assert not torch.cuda.is_initialized(), "cuda"
assert not {"uavrl.cli.train", "uavrl.cli.evaluate"} & set(sys.modules), "a command"
for _ in range(2):
    if not os.fork():
        print(np.random.random(), flush=True)
        os._exit(0)
    os.wait()
"""


def run(program: str) -> str:
    alone = os.environ | {"OMP_NUM_THREADS": "1"}  # more threads would be those of OpenBLAS, which end at a fork
    return subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, env=alone).stdout


def test_forked_processes_draw_numbers_of_their_own() -> None:
    one, other = run(LOADS.format(before="", loads=True) + FORKS).split()
    assert one != other


def test_what_cannot_be_loaded_is_left_to_the_command() -> None:
    broken = "sys = __import__('sys'); sys.modules['torchrl'] = None"
    assert run(LOADS.format(before=broken, loads=False)) == ""
