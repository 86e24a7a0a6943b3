"""Imports run one way, from floor to floor, and never in a circle."""

from __future__ import annotations

from graphlib import TopologicalSorter

import grimp

# From the top; rooms of one floor do not know each other.
FLOORS = [
    {"__main__"},
    {"cli"},
    {"reporting", "viewer"},
    {"training", "pretraining", "deploy"},
    {"collectors", "rollout"},
    {"buffers", "envs", "losses"},
    {"models", "transforms"},
    {"config", "runs"},
    {"mapping", "motion", "shield", "upstream"},
    {"hull"},
    {"entries"},
    {"arrays", "attitude", "ranges", "command_line", "machine", "cells", "counted", "progress_line"},
    {"errors"},
]


def test_imports_run_one_way() -> None:
    graph = grimp.build_graph("uavrl")
    rooms = {module.removeprefix("uavrl.") for module in graph.find_children("uavrl")}
    assert rooms <= set().union(*FLOORS), "every room has a floor"
    layers = [floor & rooms for floor in FLOORS if floor & rooms]
    climbing = graph.find_illegal_dependencies_for_layers(layers=layers, containers={"uavrl"})
    assert not climbing, climbing
    modules = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    TopologicalSorter(modules).prepare()  # raises an error that names the circle
