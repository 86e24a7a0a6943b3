"""Help and mistyped names are answered without loading torch, which takes seconds; a value out of range soon after."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

HEAVY = ("torch", "torchrl", "tensordict", "pybullet", "sklearn", "matplotlib")
RUN = """
import sys
from {package}.cli.{command} import main
for argument in {arguments!r}:
    sys.argv = ["uavrl-{command}", *argument.split()]
    code = 0
    try:
        main()
    except SystemExit as end:
        code = end.code or 0
    print("code", code, "loaded", *(name for name in {heavy!r} if name in sys.modules))
"""
LIGHT = {
    "train": {
        "algo=typo": "algo must be one of crossq, crossq_td3, ddpg, sac, td3, xqc, xqc_td3",
        "algo.gama=0.9": "'algo.gama'",
        "lifeguard.capacity=3": "lifeguard.capacity",
        "trainer.episodes=-1": "trainer.episodes must be at least 1, got -1",
        "reward._target_=os.system": "os is no package that you have listed",
    },
    "evaluate": {
        "policy=straight progress=false episodes=0": "episodes must be at least 1, got 0",
        "episodes=8": "Give either run=RUN_FOLDER or policy=NAME, and not both.",
        "run=no/such/run": "no/such/run",
    },
    "pretrain": {"pretrain.stats=0": "There is no key 'pretrain.stats': did you mean pretrain.states?"},
    "fly": {"policy=none": "goal must be three numbers"},
    "sitl": {"speed=0": "speed must be", "firmware=betaflight": "firmware must be one of px4, ardupilot"},
    "scan": {"source=none.bin": "There is no none.bin: give udp://:PORT, a capture"},
    "export": {"output=null": "output must be a folder to write the policy to"},
}
PACKAGE = {"fly": "uavrl_onboard", "scan": "uavrl_onboard"}
SLOW = {
    "algo.gamma=1.5": "algo.gamma must be in [0, 1), got 1.5",
    "+reward.arived_reward=1": "did you mean reward.arrived_reward?",
}
SECONDS = 12.0  # of a processor; an idle one takes 5, one that others load up to twice as long


@pytest.mark.parametrize("command", LIGHT)
def test_help_and_mistakes_are_told_before_anything_heavy_loads(command: str) -> None:
    """One process for all: what one of them loads, the last one shows."""
    told = LIGHT[command]
    code = RUN.format(package=PACKAGE.get(command, "uavrl"), command=command, arguments=[*told, "--help"], heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    for said, line in zip(told.values(), done.stderr.splitlines(), strict=True):
        assert said in line
    assert f"uavrl-{command} KEY=VALUE" in done.stdout
    ends = [line for line in done.stdout.splitlines() if line.startswith("code ")]
    assert ends == ["code 1 loaded"] * len(told) + ["code 0 loaded"]


@pytest.mark.parametrize("argument", SLOW)
def test_a_value_out_of_range_is_told_in_seconds(argument: str) -> None:
    before = os.times()
    command = [sys.executable, "-m", "uavrl.cli.train", argument]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    after = os.times()
    assert SLOW[argument] in done.stderr and len(done.stderr.splitlines()) == 1
    computed = after.children_user + after.children_system - before.children_user - before.children_system
    assert computed < SECONDS
