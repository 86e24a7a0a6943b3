"""What an evaluation says of the worlds that it flew in."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh

from tests.helpers.commands import in_process
from uavrl.cli.evaluate import main as evaluate


def test_planes_in_the_world_of_a_file_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They move with the steps of all vehicles there, too, so that both belong to the tasks."""
    floor, pillar = (trimesh.creation.box(size) for size in ((30, 20, 0.2), (1, 1, 8)))
    trimesh.util.concatenate([floor, pillar.apply_translation((2, 0, 4))]).export(tmp_path / "site.stl")
    world = ["env=mesh", f"env.world.file={tmp_path / 'site.stl'}", "env.world.planes=1", "env.max_steps=3"]
    short = ["episodes=2", "num_uavs=2", "progress=false", f"output={tmp_path / 'found.json'}"]
    assert in_process(evaluate, "policy=straight", *world, *short) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert (found["planes"], found["num_uavs"]) == (1, 2) and "valleys" not in found
    assert "Watch it fly: uavrl-replay policy=straight env=mesh" in capsys.readouterr().out
