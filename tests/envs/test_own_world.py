"""The example's world, which uavrl knows nothing of, is chosen on the command line and evaluated."""

from __future__ import annotations

import ast
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.commands import in_process
from tests.helpers.own_parts import CONFIG_DIR, OWN, TRUSTED
from uavrl.cli import evaluate as command
from uavrl.envs.mesh import icosphere
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.rules import Scene, Solid, WorldRules
from uavrl.envs.terrain import HeightField
from uavrl.envs.world import World
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh

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


BALL, SIZE = icosphere(1), (14.0, 12.0)
LEVEL = HeightField(np.zeros((2, 2)), SIZE)


@dataclass
class Returned(WorldRules):
    """A world whose ``scene`` returns what a test says."""

    returned: Any = None

    def scene(self, number: int) -> Scene:
        return self.returned


def broken(corner: float = 0.0, face: int = 0) -> Mesh:
    vertices, faces = BALL.vertices.copy(), BALL.faces.copy()
    vertices[3, 0] += corner
    faces[0, 0] += face
    return Mesh(vertices, faces)


@pytest.mark.parametrize(
    ("returned", "told"),
    [
        (None, r"Returned\.scene must return a Scene, got NoneType: return Scene\("),
        (BALL, "must return a Scene, got Mesh"),
        (Scene([BALL], SIZE), "The obstacle 0 that .* must be a Solid of a Mesh, got a Mesh: write Solid"),  # type: ignore[list-item]
        (Scene([Solid("ball", (BALL.vertices, BALL.faces))], SIZE), "must be a Solid of a Mesh, got a Solid of tuple"),  # type: ignore[arg-type]
        (Scene(5, SIZE), "must return a list of Solids, got int"),  # type: ignore[arg-type]
        (Scene([Solid("ball", broken(np.nan))], SIZE), "has 1 of 42 vertices that are no finite numbers"),
        (Scene([Solid("ball", broken(np.inf))], SIZE), "has 1 of 42 vertices that are no finite numbers"),
        (Scene([Solid("ball", broken(face=100))], SIZE), r"has faces of the vertices 0 to 1\d\d, but .* are 0 to 41"),
        (Scene([Solid("ball", broken(face=-100))], SIZE), r"has faces of the vertices -\d+ to 41"),
        *(
            (Scene([], size), "a size of two lengths above 0")  # type: ignore[arg-type]
            for size in ((14.0,), (14.0, -1.0), (14.0, np.nan), "ab", 5)
        ),
        (
            Scene([], (200.0, 30.0)),
            r"size of \(200\.0, 30\.0\) m, but the world's size is \(14\.0, 12\.0\) m, by which",
        ),
        (Scene([], SIZE, np.zeros((2, 2))), "a HeightField or None as ground, got ndarray"),  # type: ignore[arg-type]
        (Scene([], SIZE, HeightField(np.full((2, 2), np.nan), SIZE)), "heights that are no finite numbers"),
    ],
)
def test_what_makes_no_place_is_told(returned: Any, told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        World(Returned(size=SIZE, returned=returned))


def test_a_size_may_be_an_array() -> None:
    scene = Scene([Solid("ball", BALL)], np.array(SIZE), LEVEL)  # type: ignore[arg-type]
    (place,) = World(Returned(size=SIZE, min_goal_distance=5.0, returned=scene)).places
    assert place.size == SIZE and isinstance(place.size, tuple)


def test_the_error_of_a_scene_is_seen() -> None:
    """PyTorch takes an AttributeError in a property for a property that is not there."""

    @dataclass
    class Mistyped(WorldRules):
        spacing: float = 4.0

        def scene(self, number: int) -> Scene:
            return self.spacng  # type: ignore[attr-defined]

    with pytest.raises(RuntimeError, match=r"The world Mistyped cannot be built: 'Mistyped' object has no .* 'spacng'"):
        NavigationEnv(1, world=Mistyped()).reset()
