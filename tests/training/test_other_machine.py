"""A run goes on, and a sweep is shared, on machines that have other devices, compilers and libraries."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.helpers.configs import changed, with_run_dir
from tests.helpers.runs import SMALL, small_config
from uavrl.errors import UavrlError
from uavrl.runs.config import FREE_KEYS, MACHINE_KEYS, fingerprint, fingerprints, free_keys, read_config
from uavrl.training import arithmetic
from uavrl.training.run import create_run, resume_config
from uavrl.training.sweep import run_folder

OTHER = {"device": "cuda", "trainer.execution": "eager", "trainer.threads": 2, "trainer.products": "bf16"}


@pytest.fixture
def without_onednn(monkeypatch: pytest.MonkeyPatch) -> None:
    obstacle = "PyTorch does not hand products to oneDNN on this machine; choose mkl"
    monkeypatch.setattr(arithmetic, "_obstacle", lambda name: None if name == "mkl" else obstacle)


def recorded(run_dir: Path, **values: str) -> Path:
    """A run folder that another machine has made."""
    run_dir = create_run(small_config(run_dir))
    config = read_config(run_dir)
    for key, value in values.items():
        OmegaConf.update(config, key.replace("__", "."), value)
    (run_dir / "config.yaml").write_text(OmegaConf.to_yaml(config))
    return run_dir


@pytest.mark.usefixtures("without_onednn")
def test_products_that_this_machine_has_not_become_its_own(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    run_dir = recorded(tmp_path / "run", trainer__products="onednn")
    config = resume_config(run_dir, small_config(run_dir), [])
    assert config.trainer.products == "mkl"
    assert caplog.messages == [
        f"{run_dir} goes on with trainer.products=mkl (before: onednn): from here on last digits may differ."
    ]


@pytest.mark.usefixtures("without_onednn")
def test_the_advice_to_choose_others_is_accepted(tmp_path: Path) -> None:
    run_dir = recorded(tmp_path / "run", trainer__products="bf16")
    with pytest.raises(UavrlError, match="choose mkl"):
        resume_config(run_dir, small_config(run_dir), [])
    assert resume_config(run_dir, small_config(run_dir), ["trainer.products"]).trainer.products == "mkl"


def test_a_run_may_leave_its_gpu_and_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    run_dir = recorded(tmp_path / "run", device="cuda")
    assert resume_config(run_dir, small_config(run_dir), ["device"]).device == "cpu"
    assert "goes on with device=cpu (before: cuda)" in caplog.text
    with pytest.raises(UavrlError, match=r"algo\.gamma would change it"):
        resume_config(run_dir, changed(["run_dir=here", *SMALL], "algo.gamma=0.5"), ["algo.gamma"])


def test_a_run_on_the_machine_that_it_knows_says_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    run_dir = create_run(small_config(tmp_path / "run"))
    before = (run_dir / "config.yaml").read_text()
    assert OmegaConf.to_yaml(resume_config(run_dir, small_config(run_dir), [])) == before
    assert not caplog.messages


@pytest.mark.parametrize("key", MACHINE_KEYS)
def test_a_sweep_s_folder_is_the_same_on_every_machine(key: str, tmp_path: Path) -> None:
    one, other = (with_run_dir(tmp_path / "run", *SMALL) for _ in range(2))
    OmegaConf.update(other, key, OTHER[key])
    assert run_folder(one) == run_folder(other)
    OmegaConf.update(other, "seed", 5)
    other.run_dir = one.run_dir = "here"
    assert run_folder(one) != run_folder(other)


def test_a_sweep_keeps_what_a_run_has_chosen_by_itself() -> None:
    config = with_run_dir(Path("run"), "device=auto", "trainer.products=auto", "trainer.execution=eager")
    keys = free_keys(config)
    assert "trainer.products" not in keys
    assert {"device", "trainer.execution", "trainer.threads", "trainer.episodes"} <= set(keys)


def test_checkpoints_from_before_that_was_so_are_known(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run")
    assert fingerprints(config) == (fingerprint(config), fingerprint(config, FREE_KEYS))
    assert len(set(fingerprints(config))) == 2
