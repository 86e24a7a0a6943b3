"""Run folders made by hand."""

from __future__ import annotations

import copy
import csv
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from omegaconf import OmegaConf

from uavrl.config import compose, resolve
from uavrl.runs.episodes import Episode

ROOT = Path(__file__).resolve().parents[2]
OUTCOMES = {"a": "arrived", "c": "collided", "t": "timed_out"}


def episodes(outcomes: str, world_seed: int = 0) -> list[Episode]:
    """Episodes of ten steps each; one that arrives returns 100, any other -10."""
    return [
        Episode(i + 1, 10 * (i + 1), OUTCOMES[o], 100.0 if o == "a" else -10.0, 10, 0, 0, 3.5, 5, 5, 3.5, world_seed, i)
        for i, o in enumerate(outcomes)
    ]


@cache
def _default() -> dict[str, Any]:
    config = OmegaConf.to_container(resolve(compose("run_dir=here")))
    assert isinstance(config, dict)
    return {str(key): value for key, value in config.items()}


def config(choices: dict[str, str] | None = None, **changes: Any) -> dict[str, Any]:
    """What ``uavrl-train`` writes, values changed by dotted name (two underscores for a dot)."""
    result = copy.deepcopy(_default())
    result["choices"].update(choices or {})
    for key, value in changes.items():
        node = result
        *parents, leaf = key.split("__")
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = value
    return result


def write_episodes(path: Path, rows: Sequence[Episode]) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([Episode.header(), *(row.row() for row in rows)])


def run_folder(folder: Path, outcomes: str, choices: dict[str, str] | None = None, **changes: Any) -> Path:
    """A run that has flown all its episodes, unless ``trainer__episodes`` says otherwise."""
    folder.mkdir(parents=True)
    changes = {"trainer__episodes": len(outcomes), **changes}
    (folder / "config.yaml").write_text(yaml.safe_dump(config(choices, **changes), sort_keys=False))
    write_episodes(folder / "episodes.csv", episodes(outcomes))
    return folder


POSITION_STATS = {
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


def several_runs(folder: Path) -> list[Path]:
    """Four runs of three groups, each of which has learned to arrive; one run has an evaluation."""
    learned = "ccct" * 5 + "ca" * 10 + "aaac" * 5
    runs = [
        run_folder(folder / "td3_seed0", learned, seed=0),
        run_folder(folder / "td3_seed1", learned[4:], seed=1),
        run_folder(folder / "td3_fork_seed0", learned, {"fork": "on"}),
        run_folder(folder / "td3_lg_seed0", learned, {"lifeguard": "linear"}),
    ]
    evaluation(runs[0], 8, 10, position_stats=POSITION_STATS)
    return runs
