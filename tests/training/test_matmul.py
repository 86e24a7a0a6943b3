"""What multiplies: as exactly as it says, the same twice, and given back."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from tests.helpers.runs import small_config
from uavrl.errors import UavrlError
from uavrl.training import matmul as arithmetic
from uavrl.training import run as run_module
from uavrl.training.matmul import chosen_matmul, matmul_backend
from uavrl.training.run import create_run


def test_another_name_is_refused() -> None:
    with pytest.raises(UavrlError, match=r"matmul must be one of .* got 'blas'"):
        chosen_matmul("blas")


@pytest.mark.parametrize("faster", ["mkl", "onednn"])
def test_auto_takes_the_faster(faster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arithmetic, "_obstacle", lambda name: None)
    monkeypatch.setattr(arithmetic, "product", lambda name, *_: time.sleep(1e-4 if name == faster else 1e-3))
    assert chosen_matmul("auto") == faster


def test_a_tie_is_mkl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arithmetic, "_obstacle", lambda name: None)
    monkeypatch.setattr(arithmetic.time, "perf_counter", iter(range(1000)).__next__)
    assert chosen_matmul("auto") == "mkl"


def test_the_caller_gets_its_products_back_and_other_devices_keep_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arithmetic, "_obstacle", lambda name: None)
    setting = torch.backends.mkldnn.matmul
    before = setting.fp32_precision
    drawn = torch.get_rng_state()
    with matmul_backend("onednn"):
        assert setting.fp32_precision == "bf16"
        assert not torch.backends.cuda.matmul.allow_tf32
        with matmul_backend("mkl"):
            assert setting.fp32_precision == "ieee"
        assert setting.fp32_precision == "bf16"
    assert setting.fp32_precision == before
    assert torch.equal(torch.get_rng_state(), drawn)


def test_a_run_keeps_what_auto_chose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "chosen_matmul", lambda name, threads: {"auto": "onednn"}[name])
    run_dir = create_run(small_config(tmp_path / "run", "trainer.matmul=auto"))
    assert OmegaConf.load(run_dir / "config.yaml").trainer.matmul == "onednn"
