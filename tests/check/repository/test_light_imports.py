"""What is loaded by whom: each in a process of its own, which has loaded nothing before."""

from __future__ import annotations

import statistics
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.folders import run_folder
from tests.helpers.measured import measured
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
"""
PARTS = """
import uavrl
for room in ("buffers", "losses", "models", "transforms"):
    importlib.import_module(f"uavrl.{room}")
    for name in uavrl._ROOMS[room]:
        assert getattr(uavrl, name).__name__ == name
assert "uavrl.envs.navigation" not in sys.modules
assert uavrl.load_data.__name__ == "load_data"
assert type(uavrl.ABRPlus().classifier).__name__ == "TrajectoryClassifier"
"""
REFUSED = """
from uavrl.errors import MissingExtra

for module, missing, extra in {refused!r}:
    try:
        importlib.import_module(module)
    except MissingExtra as error:
        assert isinstance(error, ImportError)
        assert f"needs {{missing}}, which is not installed: pip install 'uavrl[{{extra}}]'." in str(error), error
    else:
        raise AssertionError(module)
"""
EXTRAS = [
    *("pybullet", "pybullet_data", "embreex", "gymnasium", "gym", "hydra", "tqdm", "filelock", "threadpoolctl"),
    *("sklearn", "kneed", "wandb", "matplotlib", "stable_baselines3"),
]
BROUGHT_BY_TORCH = {"filelock"}


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


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
        "import sys\nfrom uavrl.config import compose\ncompose('preset=dagger', 'fork=on', 'lifeguard=mlp')\n"
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


def test_the_parts_need_neither_simulator_nor_trainer() -> None:
    """Their rooms, and the names that stand at the top."""
    blocked = sorted({*EXTRAS} - BROUGHT_BY_TORCH)
    result = python(WITHOUT.format(blocked=blocked) + PARTS + f"assert not set(sys.modules) & set({blocked!r})")
    assert result.returncode == 0, result.stderr


def test_what_learns_needs_no_configuration_either() -> None:
    blocked = sorted({*EXTRAS, "omegaconf", "scipy"} - BROUGHT_BY_TORCH)
    rooms = "\nfor room in ('losses', 'transforms', 'models'): importlib.import_module(f'uavrl.{room}')"
    result = python(WITHOUT.format(blocked=blocked) + rooms)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    ("blocked", "refused"),
    [
        (["pybullet"], ("uavrl.envs.simulation", "pybullet", "sim")),
        (["embreex"], ("uavrl.envs.lidar", "embreex", "sim")),
        (["gymnasium"], ("uavrl.envs.gym", "gymnasium", "sim")),
        (["gymnasium"], ("uavrl.envs.gym_vector", "gymnasium", "sim")),
        (["tqdm"], ("uavrl.runs.progress_line", "tqdm", "train")),
        (["threadpoolctl"], ("uavrl.pretraining.pipeline", "threadpoolctl", "train")),
    ],
)
def test_a_missing_extra_is_named_with_its_command(blocked: list[str], refused: tuple[str, str, str]) -> None:
    result = python(WITHOUT.format(blocked=blocked) + REFUSED.format(refused=[refused]))
    assert result.returncode == 0, result.stderr


def test_a_policy_without_the_simulator_is_refused_in_a_sentence() -> None:
    result = python(WITHOUT.format(blocked=["pybullet", "hydra"]) + "import uavrl; uavrl.load_policy('best')")
    last = result.stderr.splitlines()[-1]
    assert last.startswith("uavrl.errors.MissingExtra: This part of uavrl needs pybullet, which is not installed")
    assert "pip install 'uavrl[sim]'" in last


def test_composing_without_hydra_is_refused_in_a_sentence() -> None:
    result = python(WITHOUT.format(blocked=["hydra"]) + "from uavrl.config import compose; compose()")
    last = (
        "uavrl.errors.MissingExtra: This part of uavrl needs hydra, which is not installed: pip install 'uavrl[train]'."
    )
    assert result.stderr.splitlines()[-1] == last


@pytest.mark.parametrize("start", ["uavrl.cli.train", "uavrl.cli.evaluate", "uavrl.cli.main"])
def test_a_command_without_hydra_ends_in_a_sentence(start: str) -> None:
    code = f"sys.argv = ['uavrl', 'train']; from {start} import main; main()"
    result = python(WITHOUT.format(blocked=["hydra"]) + code)
    said = "uavrl: This part of uavrl needs hydra, which is not installed: pip install 'uavrl[train]'.\n"
    assert (result.returncode, result.stderr) == (1, said)


@measured
def test_importing_uavrl_takes_no_time() -> None:
    """50 ms of a processor more than Python alone: the median of seven, each in a process of its own."""
    heavy = ("torch", "torchrl", "tensordict", "gymnasium", "pybullet", "numpy")
    code = (
        f"import time; b = time.process_time(); import sys, uavrl; print(time.process_time() - b); "
        f"assert not set(sys.modules) & set({heavy!r})"
    )
    runs = [python(code) for _ in range(7)]
    assert all(run.returncode == 0 for run in runs), runs[0].stderr
    assert statistics.median(float(run.stdout) for run in runs) <= 0.05
