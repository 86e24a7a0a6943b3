"""What can be answered without torch is answered without loading it, which takes seconds."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("torch", "torchrl", "tensordict", "pybullet", "sklearn", "matplotlib")
RUN = """
import sys
from uavrl.cli.{command} import main
sys.argv = ["uavrl-{command}", {argument!r}]
code = None
try:
    main()
except SystemExit as end:
    code = end.code
print("code", code, "loaded", *(name for name in {heavy!r} if name in sys.modules))
"""


def run(command: str, argument: str) -> subprocess.CompletedProcess[str]:
    code = RUN.format(command=command, argument=argument, heavy=HEAVY)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("command", ["train", "evaluate", "pretrain"])
def test_help_loads_nothing_heavy(command: str) -> None:
    result = run(command, "--help")
    assert f"uavrl-{command} KEY=VALUE" in result.stdout, result.stderr
    assert result.stdout.splitlines()[-1] in ("code None loaded", "code 0 loaded")


@pytest.mark.parametrize(
    ("command", "argument", "told"),
    [
        ("train", "algo=typo", "algo must be one of ddpg, sac, td3"),
        ("train", "trainer.episodes=-1", "trainer.episodes must be at least 1, got -1"),
        ("train", "algo.gamma=1.5", "algo.gamma must be in [0, 1), got 1.5"),
        ("train", "reward.arrived_reward=much", "reward.arrived_reward must be a number, got 'much'"),
        ("train", "+reward.arived_reward=1", "did you mean reward.arrived_reward?"),
        ("train", "reward._target_=os.system", "os is no package that you have listed"),
        ("evaluate", "seed=1", "Give either run=RUN_FOLDER or policy=NAME"),
        ("evaluate", "episodes=0", "episodes must be at least 1, got 0"),
        ("pretrain", "pretrain.states=0", "pretrain.states must be at least 1, got 0"),
    ],
)
def test_a_mistake_is_told_before_anything_heavy_loads(command: str, argument: str, told: str) -> None:
    result = run(command, argument)
    assert told in result.stderr
    assert result.stdout.splitlines()[-1] == "code 1 loaded"
