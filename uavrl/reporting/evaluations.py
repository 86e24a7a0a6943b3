"""What ``uavrl-evaluate`` left in a run folder, read and checked."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from uavrl.training.episodes import RATES


def read_json(path: Path, notes: list[str]) -> dict[str, Any] | None:
    """A json file, or None where it is missing; a damaged one is noted."""
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, OSError, RecursionError):
        content = None
    if not isinstance(content, dict):
        notes.append(f"{path.name} is damaged and was not read.")
        return None
    return content


def read_evaluations(folder: Path, notes: list[str]) -> list[dict[str, Any]]:
    """What ``uavrl-evaluate`` left in a folder, each with its ``file``, without single flights.

    Args:
        folder: of a run.
        notes: takes a sentence for each file that is not read.
    """
    found = []
    for path in sorted(folder.glob("evaluation*.json")):
        content = read_json(path, notes)
        if content is None:
            continue
        try:
            rates = {name: _rate(content[name]) for name in RATES}
            episodes = int(content["episodes"])
            places = _whereabouts(content.get("whereabouts"))
            for value in content.values():
                if isinstance(value, int):
                    float(value)  # some are too large for a float, and could not be shown
        except (KeyError, TypeError, ValueError, OverflowError):
            notes.append(f"{path.name} is not what uavrl-evaluate writes and was not read.")
            continue
        content.pop("flights", None)
        found.append({**content, "file": path.name, "episodes": episodes, "whereabouts": places, **rates})
    return found


def _whereabouts(content: dict[str, Any] | None) -> dict[str, Any] | None:
    """Where the flights went, or None where an evaluation does not tell it."""
    if content is None:
        return None
    spreads = {key: {p: float(content[key][p]) for p in ("p5", "p50", "p95")} for key in ("altitude", "wall_distance")}
    first, second, third, fourth = (float(share) for share in content["height_quarters"])
    bars = content["altitude_histogram"]
    counts = [int(count) for count in bars["counts"]]
    low, step = float(bars["low"]), float(bars["step"])
    told = [
        first,
        second,
        third,
        fourth,
        low,
        step,
        *(value for spread in spreads.values() for value in spread.values()),
    ]
    if not (all(map(math.isfinite, told)) and min(counts) >= 0 < sum(counts)):
        raise ValueError("Its numbers are none.")
    histogram = {"low": low, "step": step, "counts": counts}
    return {**spreads, "height_quarters": [first, second, third, fourth], "altitude_histogram": histogram}


def _rate(content: dict[str, Any]) -> dict[str, float]:
    rate, low, high = (float(content[key]) for key in ("rate", "low", "high"))
    if not (0 <= low <= rate + 1e-9 and rate <= high + 1e-9 <= 1 + 2e-9):
        raise ValueError("It is no rate with its interval.")
    return {"rate": rate, "low": low, "high": high}
