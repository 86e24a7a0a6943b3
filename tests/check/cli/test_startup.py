"""Help and mistyped names are answered without loading torch, which takes seconds; a value out of range soon after."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from uavrl.evaluation.policies import PACKAGED

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
WITHOUT = """
import sys
sys.modules.update(dict.fromkeys({heavy!r}))  # an import of one of them fails
from uavrl.cli.{command} import main
sys.argv = ["uavrl-{command}", *{arguments!r}]
main()
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


def sentences(shown: str) -> list[str]:
    """What a command writes without its first line, which says that it loads something."""
    return [line for line in shown.splitlines() if not line.startswith("Loading ")]


@pytest.mark.parametrize("command", LIGHT)
def test_help_and_mistakes_are_told_before_anything_heavy_loads(command: str) -> None:
    """One process for all: what one of them loads, the last one shows."""
    told = LIGHT[command]
    code = RUN.format(package=PACKAGE.get(command, "uavrl"), command=command, arguments=[*told, "--help"], heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    for said, line in zip(told.values(), sentences(done.stderr), strict=True):
        assert said in line
    assert f"uavrl-{command} KEY=VALUE" in done.stdout
    ends = [line for line in done.stdout.splitlines() if line.startswith("code ")]
    assert ends == ["code 1 loaded"] * len(told) + ["code 0 loaded"]


def test_a_taken_run_folder_is_refused_before_anything_heavy_loads(tmp_path: Path) -> None:
    (tmp_path / "run/checkpoints").mkdir(parents=True)
    (tmp_path / "run/checkpoints/checkpoint-1").touch()
    code = RUN.format(package="uavrl", command="train", arguments=[f"run_dir={tmp_path / 'run'}"], heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    (told,) = done.stderr.splitlines()
    assert f"already contains a run: resume it with uavrl-train resume={tmp_path / 'run'}" in told
    assert done.stdout == "code 1 loaded\n"


@pytest.mark.parametrize(
    ("command", "arguments", "first"),
    [
        ("train", ["run_dir=FOLDER/run"], "Loading PyTorch ..."),
        ("evaluate", ["policy=best"], "Loading best ..."),
        ("replay", ["policy=best"], "Loading best ..."),
        ("export", ["policy=best", "output=FOLDER/policy"], "Loading best ..."),
        ("pretrain", [f"run={PACKAGED / 'best'}"], f"Loading {PACKAGED / 'best'} ..."),
        ("sitl", [], "Loading the simulator ..."),
    ],
)
def test_the_first_line_comes_before_anything_heavy_loads(
    command: str, arguments: list[str], first: str, tmp_path: Path
) -> None:
    given = [each.replace("FOLDER", str(tmp_path)) for each in arguments]
    code = WITHOUT.format(command=command, arguments=given, heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 1 and done.stderr.splitlines()[0] == first
    assert any(name in done.stderr.partition("\n")[2] for name in HEAVY), done.stderr


@pytest.mark.parametrize("argument", SLOW)
def test_a_value_out_of_range_is_told_in_seconds(argument: str) -> None:
    before = os.times()
    command = [sys.executable, "-m", "uavrl.cli.train", argument]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    after = os.times()
    (sentence,) = sentences(done.stderr)
    assert SLOW[argument] in sentence
    computed = after.children_user + after.children_system - before.children_user - before.children_system
    assert computed < SECONDS
