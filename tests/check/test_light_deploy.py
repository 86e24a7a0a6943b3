"""``uavrl.deploy`` and ``uavrl-scan`` on a machine that has neither PyTorch nor the simulator."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.helpers.exported import exported
from tests.helpers.packets import RECORDED

WITHOUT = """
import importlib, importlib.abc, pkgutil, sys

class Without(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked!r}:
            raise ModuleNotFoundError("No module named " + repr(name), name=name)

sys.meta_path.insert(0, Without())
{run}
"""
SIMULATOR = ["torch", "torchrl", "tensordict", "pybullet", "embreex", "gymnasium", "sklearn", "wandb"]
CHECKED = [
    "contract",
    "policy",
    "export",
    "onnx_export",
    "motion_terms",
    "simulated",
    "logged_flight",
]  # pydantic checks a contract; export, with onnx_export and motion_terms, and simulated have torch


def without(blocked: list[str], run: str, folder: Path) -> subprocess.CompletedProcess[str]:
    code = WITHOUT.format(blocked=blocked, run=run)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder, check=False)


def test_an_exported_policy_needs_neither_torch_nor_the_simulator(tmp_path: Path) -> None:
    run = """
from uavrl_onboard.policy.policy import Policy
try:
    Policy("nowhere")
except ValueError as error:
    print(error)
"""
    done = without([*SIMULATOR, "hydra", "omegaconf", "scipy", "plotly"], run, tmp_path)
    assert done.stdout.startswith("Expected an exported policy with nowhere/contract.json"), done.stderr


def test_the_room_needs_numpy_alone(tmp_path: Path) -> None:
    run = f"""
import uavrl.deploy
for module in pkgutil.iter_modules(uavrl.deploy.__path__):
    if module.name not in {CHECKED!r}:
        importlib.import_module("uavrl.deploy." + module.name)
from uavrl_onboard.lidar.sources import ScanSource
print(len(list(ScanSource({str(RECORDED)!r}, "VLP16"))))
print(sorted(set(sys.modules) & {{"hydra", "pydantic", "torch", "scipy", "rosbags", "velodyne_decoder"}}))
"""
    libraries = ["hydra", "omegaconf", "pydantic", "scipy", "plotly"]
    libraries += ["cyclonedds", "mcap", "pymavlink", "rosbags", "velodyne_decoder"]
    done = without([*SIMULATOR, *libraries], run, tmp_path)
    assert done.stdout.splitlines() == ["2", "[]"], done.stderr


def test_the_command_looks_at_a_scan_and_draws_it(tmp_path: Path) -> None:
    run = f"""
from uavrl_onboard.cli.scan import main
sys.argv = ["uavrl-scan", "source=" + {str(RECORDED)!r}, "model=VLP16", "json=facts.json"]
main()
"""
    done = without(SIMULATOR, run, tmp_path)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert json.loads((tmp_path / "facts.json").read_text())["scans"] == 2
    assert (tmp_path / "scan.html").stat().st_size > 1_000_000


def test_the_command_flies_a_recording(tmp_path: Path) -> None:
    folder = exported(tmp_path, "algo.hidden=[16,8]")
    run = f"""
from uavrl_onboard.cli.fly import main
sys.argv = ["uavrl-fly", "policy=" + {str(folder)!r}, "goal=[20,0,2.5]", "lidar=" + {str(RECORDED)!r}, "model=VLP16"]
sys.argv += ["autopilot=null", "log=null", "json=facts.json"]
main()
"""
    done = without(SIMULATOR, run, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == "Vehicle: in_control (a dry run: set-points are sent to nobody)\n"
    assert json.loads((tmp_path / "facts.json").read_text())["scans"] == 2
