"""What is loaded by whom: each in a process of its own, which has loaded nothing before."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.folders import run_folder
from uavrl.models.psae import packaged_artifact

WITHOUT = """
import importlib, sys

class Without:
    def __init__(self, finder):
        self.finder = finder

    def __getattr__(self, name):
        return getattr(self.finder, name)

    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in {blocked!r} else self.finder.find_spec(name, path, target)

sys.meta_path[:] = [Without(finder) for finder in sys.meta_path]
import uavrl
for module in ("uavrl.losses", "uavrl.transforms", "uavrl.models"):
    importlib.import_module(module)
assert not set(sys.modules) & set({blocked!r})
assert "uavrl.envs.navigation" not in sys.modules

from uavrl.errors import MissingSimulator

for module, missing in (("uavrl.envs.simulation", "pybullet"), ("uavrl.envs.lidar", "embreex")):
    try:
        importlib.import_module(module)
    except MissingSimulator as error:
        assert isinstance(error, ImportError)
        assert f"needs {{missing}}" in str(error) and "not installed: it runs on Linux x86-64 and macOS" in str(error)
    else:
        raise AssertionError(module)
"""


def test_importing_uavrl_loads_nothing_heavy() -> None:
    heavy = ("torch", "pybullet", "embreex", "hydra", "wandb")
    modules = "sys, uavrl, uavrl_onboard.policy.contract, uavrl_onboard.policy.policy"
    code = f"import {modules}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_report_needs_neither_torch_nor_pybullet(tmp_path: Path) -> None:
    run = run_folder(tmp_path / "run", "ca")
    code = (
        "import sys, pathlib\n"
        "from uavrl.reporting.page import page; from uavrl.reporting.report import make_report\n"
        "page(make_report([pathlib.Path(sys.argv[1])]))\n"
        "assert not {'torch', 'tensordict', 'pybullet'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(run)], check=True, timeout=600)


def test_composing_needs_no_torch() -> None:
    code = (
        "import sys\nfrom uavrl.config import compose\ncompose('preset=best', 'fork=on', 'lifeguard=mlp')\n"
        "print([name for name in ('torch', 'torchrl', 'tensordict', 'pybullet') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[]", done.stderr


@pytest.mark.parametrize("command", ["evaluate", "replay"])
def test_a_mistyped_policy_is_refused_without_torch(command: str) -> None:
    code = (
        f"import sys; from uavrl.cli.{command} import main\nsys.argv = ['uavrl', 'policy=vfh_sta']\n"
        "try:\n    main()\nfinally:\n    print([name for name in ('torch', 'pybullet') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "got 'vfh_sta': did you mean vfh_star?" in done.stderr and done.returncode == 1
    assert done.stdout.strip() == "[]"


def test_loading_needs_neither_scikit_learn_nor_hydra() -> None:
    code = (
        "import sys; from uavrl.models import TrajectoryClassifier; import torch\n"
        f"print(TrajectoryClassifier.load({str(packaged_artifact())!r})(torch.zeros(2, 105)).shape)\n"
        "assert not {'sklearn', 'hydra', 'kneed', 'matplotlib', 'torchrl'} & set(sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_what_learns_needs_no_simulator() -> None:
    blocked = ["pybullet", "pybullet_data", "embreex", "hydra", "omegaconf", "wandb", "gymnasium", "gym", "scipy"]
    code = WITHOUT.format(blocked=blocked)
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
