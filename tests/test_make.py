"""Which Python `make` takes, and what it says where none fits."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="needs make")


def make(folder: Path, pythons: dict[str, int], *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs make in a new checkout, on a machine with these Pythons and the exit codes of their self-test."""
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, folder)
    (folder / "bin").mkdir()
    for name, code in pythons.items():
        (folder / "bin" / name).write_text(f"#!/bin/sh\nexit {code}\n")
        (folder / "bin" / name).chmod(0o755)
    environment = {"PATH": str(folder / "bin")}
    command = [str(shutil.which("make")), "-C", str(folder), "SHELL=/bin/sh", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("pythons", "taken"),
    [
        ({"python3.11": 0, "python3.12": 0, "python3": 0}, "python3.12"),
        ({"python3.13": 127, "python3.11": 0}, "python3.11"),  # a shim for a Python that is not switched on
        ({"python3.13": 1, "python3": 0}, "python3"),  # Debian's without its venv package
    ],
)
def test_it_takes_the_newest_python_that_fits(pythons: dict[str, int], taken: str, tmp_path: Path) -> None:
    result = make(tmp_path, pythons, "--dry-run", "setup")
    assert f"{taken} -m venv .venv" in result.stdout.splitlines(), result


def test_a_python_may_be_named(tmp_path: Path) -> None:
    result = make(tmp_path, {"python3.12": 0}, "--dry-run", "setup", "PYTHON=/opt/python")
    assert "/opt/python -m venv .venv" in result.stdout.splitlines(), result


def test_one_sentence_where_none_fits(tmp_path: Path) -> None:
    result = make(tmp_path, {"python3": 1}, "setup")
    assert result.returncode != 0
    sentence = result.stdout.splitlines()[1 if "directory" in result.stdout.splitlines()[0] else 0]
    assert sentence.startswith("uavrl needs Python 3.11, 3.12 or 3.13 with its venv module"), result
    assert not (tmp_path / ".venv").exists()


def test_the_makefile_asks_for_what_the_package_asks_for() -> None:
    assert 'requires-python = ">=3.11,<3.14"' in (ROOT / "pyproject.toml").read_text()
    assert "(3, 11) <= sys.version_info < (3, 14)" in (ROOT / "Makefile").read_text()
    assert os.access(ROOT / ".ci/check_python", os.X_OK)
