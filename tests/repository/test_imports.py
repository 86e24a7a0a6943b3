"""Imports run one way, from floor to floor and never in a circle, and what flies needs nothing of what trains."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[2]

# From the top; rooms of one floor do not know each other.
TRAINS = [
    {"__main__"},
    {"cli"},
    {"reporting", "viewer"},
    {"training", "pretraining"},
    {"sitl", "planners"},
    {"policies", "export"},
    {"evaluation", "collectors"},
    {"buffers", "envs", "losses"},
    {"models", "transforms"},
    {"runs"},
    {"config"},
    {"upstream", "entries", "exploration", "shown", "policy_protocol"},
    {"errors", "locks"},
]
FLIES = [
    {"cli"},
    {"pages"},
    {"ros2"},
    {"flight"},
    {"policy"},
    {"autopilot", "guards"},
    {"lidar"},
    {"perception"},
    {"geometry", "mesh", "values", "files", "libraries", "provenance"},
    {"sentences", "vehicle", "pluralize"},
    {"ranges", "enums"},
    {"errors"},
]
# Rooms above a module whose classes it names in strings, which are imported when a command line asks for them.
NAMED_ABOVE = {
    "uavrl.config.parts": {"training"},
    "uavrl.evaluation.policies": {"export", "planners", "policies"},
}
HEAVY = ("torch", "torchrl", "tensordict", "hydra", "pybullet", "embreex", "gymnasium", "sklearn", "uavrl")


def require_floors(package: str, floors: list[set[str]]) -> None:
    graph = grimp.build_graph(package)
    rooms = {module.removeprefix(f"{package}.") for module in graph.find_children(package)}
    assert rooms <= set().union(*floors), f"every room has a floor: {rooms - set().union(*floors)}"
    layers = [floor & rooms for floor in floors if floor & rooms]
    climbing = graph.find_illegal_dependencies_for_layers(layers=layers, containers={package})
    assert not climbing, climbing
    modules = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    TopologicalSorter(modules).prepare()  # raises an error that names the circle


def test_imports_of_what_trains_run_one_way() -> None:
    require_floors("uavrl", TRAINS)


def test_no_other_module_names_a_class_of_a_higher_floor() -> None:
    floor = {room: number for number, rooms in enumerate(TRAINS) for room in rooms}
    above: dict[str, set[str]] = {}
    for path in (ROOT / "uavrl").rglob("*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and re.fullmatch(r"uavrl(\.\w+)+\.[A-Z]\w*", str(node.value)):
                room = str(node.value).split(".")[1]
                if floor[room] < floor.get(module.split(".")[1], 0):
                    above.setdefault(module, set()).add(room)
    assert above == NAMED_ABOVE


def test_imports_of_what_flies_run_one_way() -> None:
    require_floors("uavrl_onboard", FLIES)


def test_what_flies_imports_nothing_of_what_trains() -> None:
    graph = grimp.build_graph("uavrl_onboard", include_external_packages=True)
    assert "numpy" in graph.modules
    importers = {name: graph.find_modules_that_directly_import(name) for name in HEAVY if name in graph.modules}
    assert not importers, importers
