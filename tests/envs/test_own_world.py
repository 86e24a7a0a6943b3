"""The example's world, which uavrl knows nothing of, is chosen on the command line and evaluated."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from tests.helpers.own_parts import CONFIG_DIR, OWN, TRUSTED
from uavrl.cli import evaluate as command

FEW = ["env.world.size=[14,12]", "env.world.min_goal_distance=5", "episodes=2", "num_uavs=2", "env.max_steps=40"]


def test_it_takes_at_most_20_lines() -> None:
    source = (OWN / "own_parts/world.py").read_text(encoding="utf-8")
    (world,) = [each for each in ast.parse(source).body if isinstance(each, ast.ClassDef)]
    assert world.end_lineno is not None and world.end_lineno - world.lineno + 2 <= 20  # with its decorator


def test_it_is_evaluated_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(OWN)
    output = tmp_path / "pillars.json"
    words = [*CONFIG_DIR, TRUSTED, "policy=vfh", "env=pillars", *FEW, "progress=false", f"output={output}"]
    assert in_process(command.main, *words) == 0
    result = json.loads(output.read_text())
    assert result["episodes"] == 2 and result["env"] == "pillars"
    assert all(flight["spacing"] > 0.7 and flight["detour"] >= 1 for flight in result["flights"])
    assert all(flight["clearance"] <= 5 for flight in result["flights"])
