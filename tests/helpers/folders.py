"""Run folders made by hand."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import yaml

from uavrl.envs.world import WorldConfig
from uavrl.runs.episodes import Episode

ROOT = Path(__file__).resolve().parents[2]
TEMPLATE = ROOT / "docs/journal/data/enhancers/td3_seed0/config.yaml"
DOCUMENTED = [
    ROOT / "docs/journal/data/enhancers" / name
    for name in (
        "td3_seed0",
        "td3_seed1",
        "td3_fork_seed0",
        "td3_lg_linear_seed0",
        "td3_lg_mlp_seed0",
        "td3_lg_mlp_seed1",
    )
]
OUTCOMES = {"a": "arrived", "c": "collided", "t": "timed_out"}


def episodes(outcomes: str, world_seed: int = 0) -> list[Episode]:
    """Episodes of ten steps each; one that arrives returns 100, any other -10."""
    return [
        Episode(i + 1, 10 * (i + 1), OUTCOMES[o], 100.0 if o == "a" else -10.0, 10, 0, 0, 3.5, 5, 5, 3.5, world_seed, i)
        for i, o in enumerate(outcomes)
    ]


def config(choices: dict[str, str] | None = None, **changes: Any) -> dict[str, Any]:
    """A real run's configuration with today's keys, values changed by dotted name (two underscores for a dot)."""
    result = yaml.safe_load(TEMPLATE.read_text())
    result["choices"].update(choices or {})
    result["perception"].setdefault("blind", False)  # a key that is younger than that run
    world = result["env"]["world"]
    result["env"]["world"] = {field.name: world[field.name] for field in fields(WorldConfig) if field.name in world}
    for key, value in changes.items():
        node = result
        *parents, leaf = key.split("__")
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = value
    return result


def write_episodes(path: Path, rows: Sequence[Episode]) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([Episode.header(), *map(astuple, rows)])


def run_folder(folder: Path, outcomes: str, choices: dict[str, str] | None = None, **changes: Any) -> Path:
    """A run that has flown all its episodes, unless ``trainer__episodes`` says otherwise."""
    folder.mkdir(parents=True)
    changes = {"trainer__episodes": len(outcomes), **changes}
    (folder / "config.yaml").write_text(yaml.safe_dump(config(choices, **changes), sort_keys=False))
    write_episodes(folder / "episodes.csv", episodes(outcomes))
    return folder


WHEREABOUTS = {
    "steps": 8,
    "altitude": {"p5": 2.04, "p50": 3.46, "p95": 4.9},
    "height_quarters": [0.125, 0.25, 0.5, 0.125],
    "wall_distance": {"p5": 1.1, "p50": 6.2, "p95": 13.3},
}


def evaluation(folder: Path, arrived: int, tasks: int, name: str = "evaluation.json", **changes: Any) -> Path:
    """What ``uavrl-evaluate`` writes; what did not arrive has collided."""
    from uavrl.runs.episodes import wilson

    result = {
        "episodes": tasks,
        "success": wilson(arrived, tasks),
        "collision": wilson(tasks - arrived, tasks),
        "time_out": wilson(0, tasks),
        "path_efficiency": 0.79,
        "median_clearance": 0.74,
        "min_clearance": 0.1,
        "steps_per_episode": 90.0,
        "steps_per_arrival": 92.0,
        "seed": 20_000,
        "env": "static",
        "valleys": [0],
        "training_steps": 40,
        "flights": [{"task": 0}],
        **changes,
    }
    path = folder / name
    path.write_text(json.dumps(result))
    return path
