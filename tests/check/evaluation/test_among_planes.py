"""A policy that senses nothing collides with planes, and far less often where it is kept out of their ways."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from uavrl.cli import evaluate

PLANES = [
    "env=dynamic",
    "valleys=training",
    "env.world.planes=20",
    "env.world.obstacles=0",
    "episodes=40",
    "progress=false",
]


@pytest.mark.parametrize(
    ("guards", "least", "most"), [("none", 8, 40), pytest.param("evasion", 0, 6, marks=pytest.mark.slow), ("all", 0, 6)]
)
def test_flying_straight_among_planes(guards: str, least: int, most: int, tmp_path: Path) -> None:
    """It collides in 10 and 3 of the 40 tasks; nothing else is in its way."""
    output = tmp_path / "result.json"
    assert in_process(evaluate.main, "policy=straight", f"guards={guards}", *PLANES, f"output={output}") == 0
    outcomes = json.loads(output.read_text(encoding="utf-8"))["outcomes"]
    assert least <= outcomes.count("C") <= most, outcomes
