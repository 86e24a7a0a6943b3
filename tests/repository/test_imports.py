"""Imports run one way, from floor to floor and never in a circle, and what flies needs nothing of what trains."""

from __future__ import annotations

from graphlib import TopologicalSorter

import grimp

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
    {"upstream", "entries", "policy_protocol"},
    {"errors"},
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


def test_imports_of_what_flies_run_one_way() -> None:
    require_floors("uavrl_onboard", FLIES)


def test_what_flies_imports_nothing_of_what_trains() -> None:
    graph = grimp.build_graph("uavrl_onboard", include_external_packages=True)
    assert "numpy" in graph.modules
    importers = {name: graph.find_modules_that_directly_import(name) for name in HEAVY if name in graph.modules}
    assert not importers, importers
