"""What multiplies, in processes of its own: as exactly as it says, and the same twice."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import OmegaConf

from tests.helpers.runs import assert_same_run
from uavrl.training import matmul as arithmetic
from uavrl.training.matmul import matmul_backend, with_matmul_backend

ROOT = Path(__file__).resolve().parents[3]
ERROR = """
import json, sys, torch
from uavrl.errors import UavrlError
from uavrl.training.matmul import matmul_backend
torch.manual_seed(1)
one, other = torch.randn(100, 400), torch.randn(400, 300)
said = {}
for name in sys.argv[1:]:
    try:
        with matmul_backend(name) as chosen:
            result = one @ other
        said[name] = [chosen, (result - one.double() @ other.double()).abs().max().item()]
    except UavrlError as error:
        said[name] = [None, str(error)]
print(json.dumps(said))
"""
TWICE = """
import sys
from pathlib import Path
from tests.helpers.runs import small_config
from uavrl.training.run import create_run, train
folder, backend = sys.argv[1:]
for name in ("one", "other"):
    wide = ["algo.hidden=[64,48]", "algo.batch_size=32", "trainer.episodes=8"]
    config = small_config(Path(folder) / name, *wide, f"trainer.matmul={backend}")
    train(config, create_run(config))
"""


def python(script: str, *arguments: str, isa: str | None = None) -> subprocess.CompletedProcess[str]:
    """Runs a script in a process of its own: oneDNN's instructions are chosen once in each."""
    environment = {key: value for key, value in os.environ.items() if key != arithmetic.ISA}
    environment |= {"OMP_NUM_THREADS": "1"} | ({} if isa is None else {arithmetic.ISA: isa})
    command = [sys.executable, "-c", script, *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, check=False)


def errors(*names: str, isa: str | None = None) -> dict[str, list[Any]]:
    result = python(ERROR, *names, isa=isa)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def test_float32_libraries_multiply_in_float32() -> None:
    said = errors("mkl", "onednn", "auto")
    assert said["mkl"][0] == "mkl"
    assert said["mkl"][1] < 1.5e-4
    assert said["auto"][0] in ("mkl", "onednn")
    assert said["auto"][1] < 1.5e-4
    if said["onednn"][0] is None:
        pytest.skip(said["onednn"][1])
    assert said["onednn"][1] < 1.5e-4
    assert said["onednn"][1] != said["mkl"][1]


def test_what_multiplies_in_less_than_float32_is_refused() -> None:
    said = errors("onednn", "auto", isa="AVX512_CORE_AMX")
    if said["onednn"][0] is not None:
        pytest.skip("this processor has no instructions that round factors")
    assert said["auto"][0] == "mkl"
    assert said["auto"][1] < 1.5e-4
    if "PyTorch does not hand products to oneDNN" in said["onednn"][1]:
        pytest.skip("this processor's instructions are too few for oneDNN at all")
    assert "computes in less than float32 in this process" in said["onednn"][1]


def test_what_the_machine_cannot_do_is_one_sentence() -> None:
    without = errors("onednn", "auto", isa="AVX2")
    assert without["onednn"][0] is None
    assert without["onednn"][1].startswith("matmul=onednn is not possible here: PyTorch does not hand")
    assert without["auto"][0] == "mkl"


def test_the_process_that_flies_multiplies_as_the_learner() -> None:
    with matmul_backend("mkl"):
        function = pickle.dumps(with_matmul_backend(torch.get_num_threads))
    script = (
        "import pickle, sys, torch; setting = torch.backends.mkldnn.matmul; before = setting.fp32_precision; "
        "pickle.loads(bytes.fromhex(sys.argv[1]))(); print(before, setting.fp32_precision)"
    )
    assert python(script, function.hex()).stdout.split() == ["none", "ieee"]


@pytest.mark.parametrize("backend", ["onednn", pytest.param("mkl", marks=pytest.mark.slow)])
def test_the_same_run_twice_is_the_same_bit_by_bit(backend: str, tmp_path: Path) -> None:
    result = python(TWICE, str(tmp_path), backend)
    if "is not possible here" in result.stderr:
        pytest.skip(result.stderr.splitlines()[-1])
    assert result.returncode == 0, result.stderr
    assert OmegaConf.load(tmp_path / "one" / "config.yaml").trainer.matmul == backend
    assert_same_run(tmp_path / "one", tmp_path / "other")
