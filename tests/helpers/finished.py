"""Finished runs to look at: each is trained once for all tests and workers while the sources stay as they are."""

from __future__ import annotations

import hashlib
import shutil
import time
from functools import cache
from importlib.metadata import version
from pathlib import Path

from filelock import FileLock

from tests.helpers.commands import in_process
from uavrl.cli import train as train_command
from uavrl.runs.provenance import commit

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / ".pytest_cache/runs"
DAY = 86_400


@cache
def _kept() -> Path:
    """The folder for runs of these sources, of this commit and with these packages; older ones are removed."""
    packages = [version(name) for name in ("torch", "torchrl", "tensordict", "numpy", "hydra-core", "pybullet")]
    digest = hashlib.sha256(repr((commit(), packages)).encode())
    for path in sorted([*(ROOT / "uavrl").rglob("*.py"), *(ROOT / "conf").rglob("*.yaml")]):
        digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    folder = KEPT / digest.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    for other in KEPT.iterdir():
        if other != folder and time.time() - other.stat().st_mtime > DAY:
            shutil.rmtree(other, ignore_errors=True)
    return folder


def finished_run(copy: Path, *overrides: str) -> Path:
    """Copies a run that was trained with these overrides to ``copy``, which the caller may change."""
    name = hashlib.sha256(repr(overrides).encode()).hexdigest()[:16]
    run_dir, trained = _kept() / name / "run", _kept() / name / "trained"
    with FileLock(_kept() / f"{name}.lock"):
        if not trained.exists():
            shutil.rmtree(run_dir.parent, ignore_errors=True)
            assert in_process(train_command.main, *overrides, f"run_dir={run_dir}") == 0
            trained.touch()
    return Path(shutil.copytree(run_dir, copy))
