"""What multiplies: as exactly as it says, the same twice, and given back."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import OmegaConf

from tests.helpers.runs import assert_same_run, small_config
from uavrl.errors import UavrlError
from uavrl.runs.checkpoint import rotation
from uavrl.training import arithmetic
from uavrl.training import run as run_module
from uavrl.training import sweep as sweep_module
from uavrl.training.arithmetic import carried, chosen_products, multiplied_by
from uavrl.training.run import create_run, resume_config, train
from uavrl.training.sweep import is_finished, run_folder

ROOT = Path(__file__).resolve().parents[2]
ERROR = """
import json, sys, torch
from uavrl.errors import UavrlError
from uavrl.training.arithmetic import multiplied_by
torch.manual_seed(1)
one, other = torch.randn(100, 400), torch.randn(400, 300)
said = {}
for name in sys.argv[1:]:
    try:
        with multiplied_by(name) as chosen:
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
folder, products = sys.argv[1:]
for name in ("one", "other"):
    wide = ["algo.hidden=[64,48]", "algo.batch_size=32", "trainer.episodes=8"]
    config = small_config(Path(folder) / name, *wide, f"trainer.products={products}")
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


def test_bf16_multiplies_in_less_and_keeps_onednn_from_float32() -> None:
    said = errors("bf16", "onednn", "auto")
    if said["bf16"][0] is None:
        pytest.skip(said["bf16"][1])
    assert said["bf16"][1] > 0.05
    assert said["onednn"][0] is None
    assert "computes in less than float32 in this process" in said["onednn"][1]
    assert said["auto"][0] == "mkl"
    assert said["auto"][1] < 1.5e-4


def test_what_the_machine_cannot_do_is_one_sentence() -> None:
    without = errors("onednn", "bf16", "auto", isa="AVX2")
    assert without["onednn"][0] is None
    for name in ("onednn", "bf16"):
        assert without[name][1].startswith(f"products={name} is not possible here: PyTorch does not hand")
    assert without["auto"][0] == "mkl"
    assert errors("bf16", isa="AVX512_CORE")["bf16"][1].startswith("products=bf16 is not possible here: ")


def test_another_name_is_refused() -> None:
    with pytest.raises(UavrlError, match=r"products must be one of .* got 'blas'"):
        chosen_products("blas")


@pytest.mark.parametrize("faster", ["mkl", "onednn"])
def test_auto_takes_the_faster(faster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arithmetic, "_obstacle", lambda name: None)
    monkeypatch.setattr(arithmetic, "product", lambda name, *_: time.sleep(1e-4 if name == faster else 1e-3))
    assert chosen_products("auto") == faster


def test_a_tie_is_mkl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arithmetic, "_obstacle", lambda name: None)
    monkeypatch.setattr(arithmetic.time, "perf_counter", iter(range(1000)).__next__)
    assert chosen_products("auto") == "mkl"


def test_the_caller_gets_its_products_back_and_other_devices_keep_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arithmetic, "_obstacle", lambda name: None)
    setting = torch.backends.mkldnn.matmul
    before = setting.fp32_precision
    drawn = torch.get_rng_state()
    with multiplied_by("onednn"):
        assert setting.fp32_precision == "bf16"
        assert not torch.backends.cuda.matmul.allow_tf32
        with multiplied_by("mkl"):
            assert setting.fp32_precision == "ieee"
        assert setting.fp32_precision == "bf16"
    assert setting.fp32_precision == before
    assert torch.equal(torch.get_rng_state(), drawn)


def test_the_process_that_flies_multiplies_as_the_learner() -> None:
    with multiplied_by("mkl"):
        function = pickle.dumps(carried(torch.get_num_threads))
    script = (
        "import pickle, sys, torch; setting = torch.backends.mkldnn.matmul; before = setting.fp32_precision; "
        "pickle.loads(bytes.fromhex(sys.argv[1]))(); print(before, setting.fp32_precision)"
    )
    assert python(script, function.hex()).stdout.split() == ["none", "ieee"]


@pytest.mark.parametrize(
    "products", ["onednn", *(pytest.param(name, marks=pytest.mark.slow) for name in ("mkl", "bf16"))]
)
def test_the_same_run_twice_is_the_same_bit_by_bit(products: str, tmp_path: Path) -> None:
    result = python(TWICE, str(tmp_path), products)
    if "is not possible here" in result.stderr:
        pytest.skip(result.stderr.splitlines()[-1])
    assert result.returncode == 0, result.stderr
    assert OmegaConf.load(tmp_path / "one" / "config.yaml").trainer.products == products
    assert_same_run(tmp_path / "one", tmp_path / "other")


def test_a_run_keeps_what_auto_chose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "chosen_products", lambda name, threads: {"auto": "onednn"}[name])
    run_dir = create_run(small_config(tmp_path / "run", "trainer.products=auto"))
    assert OmegaConf.load(run_dir / "config.yaml").trainer.products == "onednn"
    with pytest.raises(UavrlError, match=r"trainer\.products would change it"):
        resume_config(run_dir, OmegaConf.create({"packages": [], "trainer": {"products": "mkl"}}), ["trainer.products"])


def test_a_run_older_than_the_choice_goes_on_with_mkl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def noted(name: str, threads: int) -> Any:
        asked.append(name)
        return multiplied_by("mkl")

    monkeypatch.setattr(run_module, "multiplied_by", noted)
    config = small_config(tmp_path / "run", "trainer.episodes=2")
    run_dir = create_run(config)
    del config.trainer.products
    (run_dir / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    train(config, run_dir)
    more = OmegaConf.create({"packages": [], "trainer": {"episodes": 4}})
    summary = train(resume_config(run_dir, more, ["trainer.episodes"]), run_dir, resume=True)
    assert summary["episodes"] >= 4
    assert asked == ["mkl", "mkl"]
    assert rotation(run_dir).latest() is not None


def test_a_sweep_started_again_finds_what_auto_chose_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_module, "chosen_products", lambda name, threads: "onednn")
    first = small_config(tmp_path / "run", "trainer.products=auto")
    run_folder(first).mkdir()
    (Path(first.run_dir) / "config.yaml").write_text(OmegaConf.to_yaml(first, resolve=True))
    (Path(first.run_dir) / "summary.json").write_text(json.dumps({"episodes": 10_000}))
    monkeypatch.setattr(sweep_module, "chosen_products", lambda name, threads: "mkl")
    again = small_config(tmp_path / "run", "trainer.products=auto")
    assert is_finished(run_folder(again), episodes=10_000)
    assert (again.run_dir, again.trainer.products) == (first.run_dir, "onednn")
