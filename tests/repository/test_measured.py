"""Tests that depend on the machine's clock try again when a core is free."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.measured import idle_cores, wait_for_a_core

BEFORE = "cpu  100 0 50 1000 10 0 0 0 0 0\ncpu0 1 1 1\n"


@pytest.mark.parametrize(
    ("after", "idle"),
    [
        ("cpu  300 0 50 1000 10 0 0 0 0 0\n", 0.0),
        ("cpu  200 0 50 1100 10 0 0 0 0 0\n", 1.0),
        ("cpu  100 0 50 1150 60 0 0 0 0 0\n", 2.0),
        (BEFORE, 0.0),
    ],
)
def test_idle_cores_are_counted(after: str, idle: float) -> None:
    assert idle_cores(BEFORE, after, 2) == pytest.approx(idle)


def test_it_waits_no_longer_than_it_is_told(tmp_path: Path) -> None:
    busy = tmp_path / "stat"
    assert not wait_for_a_core(5.0, busy), "the system keeps no times"
    busy.write_text(BEFORE)
    assert not wait_for_a_core(1.5, busy)
