"""What can be answered without torch is answered without loading it, which takes seconds."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("torch", "torchrl", "tensordict", "pybullet", "sklearn", "matplotlib")
RUN = """
import sys
from uavrl.cli.{command} import main
for argument in {arguments!r}:
    sys.argv = ["uavrl-{command}", argument]
    code = 0
    try:
        main()
    except SystemExit as end:
        code = end.code or 0
    print("code", code, "loaded", *(name for name in {heavy!r} if name in sys.modules))
"""
MISTAKES = {
    "train": {
        "algo=typo": "algo must be one of ddpg, sac, td3",
        "trainer.episodes=-1": "trainer.episodes must be at least 1, got -1",
        "algo.gamma=1.5": "algo.gamma must be in [0, 1), got 1.5",
        "reward.arrived_reward=much": "reward.arrived_reward must be a number, got 'much'",
        "+reward.arived_reward=1": "did you mean reward.arrived_reward?",
        "reward._target_=os.system": "os is no package that you have listed",
    },
    "evaluate": {
        "seed=1": "Give either run=RUN_FOLDER or policy=NAME",
        "episodes=0": "episodes must be at least 1, got 0",
    },
    "pretrain": {"pretrain.states=0": "pretrain.states must be at least 1, got 0"},
}


@pytest.mark.parametrize("command", MISTAKES)
def test_help_and_mistakes_are_told_before_anything_heavy_loads(command: str) -> None:
    """One process for all: what one of them loads, the last one shows."""
    told = MISTAKES[command]
    code = RUN.format(command=command, arguments=[*told, "--help"], heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    for said, line in zip(told.values(), done.stderr.splitlines(), strict=True):
        assert said in line
    assert f"uavrl-{command} KEY=VALUE" in done.stdout
    ends = [line for line in done.stdout.splitlines() if line.startswith("code ")]
    assert ends == ["code 1 loaded"] * len(told) + ["code 0 loaded"]
