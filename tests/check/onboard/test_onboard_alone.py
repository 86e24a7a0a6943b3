"""uavrl-onboard alone: in an empty environment, and without the libraries that only its extras bring."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.exported import exported
from tests.helpers.packets import RECORDED

ROOT = Path(__file__).resolve().parents[3]
WITHOUT = """
import importlib, importlib.abc, pkgutil, sys

class Without(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked!r}:
            raise ModuleNotFoundError("No module named " + repr(name), name=name)

sys.meta_path.insert(0, Without())
{run}
"""
TRAINS = ["uavrl", "torch", "torchrl", "tensordict", "hydra", "pybullet", "embreex", "gymnasium", "sklearn", "wandb"]
EXTRAS = ["onnxruntime", "plotly", "cyclonedds", "mcap", "pymavlink", "rosbags", "velodyne_decoder"]


def without(blocked: list[str], run: str, folder: Path) -> subprocess.CompletedProcess[str]:
    code = WITHOUT.format(blocked=blocked, run=run)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder, check=False)


def test_each_module_and_a_recording_need_the_base_alone(tmp_path: Path) -> None:
    run = f"""
import uavrl_onboard
for module in pkgutil.walk_packages(uavrl_onboard.__path__, "uavrl_onboard."):
    importlib.import_module(module.name)
from uavrl_onboard.lidar.sources import ScanSource
print(len(list(ScanSource({str(RECORDED)!r}, "VLP16"))))
"""
    done = without(TRAINS + EXTRAS, run, tmp_path)
    assert done.stdout.splitlines() == ["2"], done.stderr


def test_the_command_looks_at_a_scan_and_draws_it(tmp_path: Path) -> None:
    run = f"""
from uavrl_onboard.cli.scan import main
sys.argv = ["uavrl-scan", "source=" + {str(RECORDED)!r}, "model=VLP16", "json=facts.json"]
main()
"""
    done = without(TRAINS, run, tmp_path)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert json.loads((tmp_path / "facts.json").read_text())["scans"] == 2
    assert (tmp_path / "scan.html").stat().st_size > 1_000_000


def test_its_own_tests_pass_without_what_trains() -> None:
    run = f"""
import pytest
options = ["-o", "addopts=--import-mode=importlib", "-p", "no:cacheprovider", "-q", {str(ROOT / "onboard/tests")!r}]
sys.exit(pytest.main(options))
"""
    code = WITHOUT.format(blocked=TRAINS, run=run)
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # Hydra brings a plugin of pytest's
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=environment)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]


def test_it_is_installed_and_flies_in_an_empty_environment(tmp_path: Path) -> None:
    folder, environment = exported(tmp_path, "algo.hidden=[16,8]"), tmp_path / "empty"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    python = environment / "bin/python"
    install = [python, "-m", "pip", "install", "--quiet", "--retries=1", "--timeout=30", "-c", ROOT / "constraints.txt"]
    done = subprocess.run([*install, f"{ROOT / 'onboard'}[all]"], capture_output=True, text=True, check=False)
    if "No matching distribution" in done.stderr or "Connection" in done.stderr:
        pytest.skip("needs a package index")
    assert done.returncode == 0, done.stderr
    listed = subprocess.run([python, "-m", "pip", "list"], capture_output=True, text=True, check=True).stdout
    assert not {"torch", "hydra-core", "pybullet", "gymnasium"} & {line.split()[0] for line in listed.splitlines()}
    flight = ["lidar=" + str(RECORDED), "model=VLP16", "goal=[20,0,2.5]", "autopilot=null", "log=flight.mcap"]
    command = [environment / "bin/uavrl-fly", f"policy={folder}", *flight, "json=facts.json"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "facts.json").read_text())["scans"] == 2
    assert (tmp_path / "flight.mcap").stat().st_size > 10_000
