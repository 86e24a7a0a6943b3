"""What the tests of all studies share."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def scripts_import_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scripts find those beside them, whichever test runs first."""
    for folder in ("benchmarks", "studies"):
        monkeypatch.syspath_prepend(ROOT / folder)


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """What a study prints."""

    def run(study: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [f"{study}.py", *map(str, arguments)])
        runpy.run_path(str(ROOT / "studies" / f"{study}.py"), run_name="__main__")
        return capsys.readouterr().out

    return run
