"""A policy's inputs can be made from its contract alone, with numpy and nothing of uavrl."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from safetensors.torch import load_file
from torch import Tensor

from tests.helpers.commands import VALLEY
from tests.helpers.recorded import READ, SCANNED, SCANS, states, unmistakable
from uavrl.config import compose, validate
from uavrl.config.settings import TrainConfig
from uavrl.envs import NavigationEnv
from uavrl.export.export import contract
from uavrl_onboard.perception.cells import RangeGrid
from uavrl_onboard.policy.contract import Cells, Contract

Values = dict[str, np.ndarray]


def derived(*overrides: str) -> tuple[TrainConfig, dict[str, Any]]:
    """The settings of some overrides, and their contract as it is read again from its file."""
    settings = validate(compose(*overrides))
    found = contract(settings, "0" * 64)
    assert found is not None
    return settings, json.loads(found.to_text())


# ---------------------------------------------------------------------- by what the contract says, and numpy


def returns(points: np.ndarray, cloud: dict[str, Any]) -> np.ndarray:
    low, high = cloud["squared_range"]
    points = points[np.isfinite(points).all(1)]
    squared = (points**2).sum(1)
    return points[(low < squared) & (squared < high)]


def cell_of(points: np.ndarray, cells: dict[str, Any]) -> np.ndarray:
    """The number of each point's cell, -1 where it is in none."""
    if cells["reduction"] == "range_image":
        x, y, z = points.T
        columns, rows = cells["columns"], cells["rows"]
        column = np.round(np.degrees(np.arctan2(y, x)) / cells["width"]) % columns
        elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
        return (rows * column + (elevation[:, None] > cells["row_borders"]).sum(1)).astype(int)
    directions, offsets = np.array(cells["directions"]), np.array(cells["offsets"])
    outside = (points @ directions.T > offsets).any(1)
    apart = np.linalg.norm(points[:, None] - offsets[:, None] * directions, axis=2)
    return np.where(outside, -1, apart.argmin(1))


def cell_values(points: np.ndarray, terms: dict[str, Any]) -> np.ndarray:
    cells, points = terms["cells"], returns(points, terms["cloud"])
    right, left, low, high = terms["cloud"]["lidar"]["cells_see"]
    azimuth, elevation = (
        np.degrees(np.arctan2(*each)) for each in (points.T[[1, 0]], (points[:, 2], np.hypot(*points.T[:2])))
    )
    seen = (azimuth >= right - 0.5) & (azimuth <= left + 0.5) & (elevation >= low - 0.5) & (elevation <= high + 0.5)
    points = points[seen]
    cell, centre = cell_of(points, cells), 0.0
    points, cell = points[cell >= 0], cell[cell >= 0]
    if cells["statistic"] == "face":
        centre = (np.array(cells["offsets"])[:, None] * np.array(cells["directions"]))[cell]
    least = np.full(cells["count"], np.inf)
    np.minimum.at(least, cell, np.linalg.norm(points - centre, axis=1).clip(*cells["interval"]))
    near = cells["radius"] - least if cells["statistic"] == "proximity" else least
    return np.where(np.isinf(least), 0.0, near)


def observation(values: Values, terms: dict[str, Any]) -> np.ndarray:
    """``values`` has the cells and what else an observation holds, each in its unit."""
    scaled = []
    for entry in terms["observation"]:
        value = values[entry["name"]] + entry["shift"]
        value = value % entry["modulo"] if entry["modulo"] is not None else value
        scaled.append(value / entry["divisor"] + entry["offset"])
        assert len(scaled[-1]) == entry["size"]
    return np.concatenate(scaled)


def state(observations: list[np.ndarray], terms: dict[str, Any]) -> np.ndarray:
    """Of all observations of an episode up to now."""
    frames, padding = terms["state"]["frames"], terms["state"]["padding"]
    before = [np.full_like(observations[-1], padding)] * max(frames - len(observations), 0)
    return np.concatenate([*before, *observations[-frames:]]).astype(terms["state"]["dtype"])


# ---------------------------------------------------------------------- the tests


def rebuilt(scans: dict[str, Tensor], terms: dict[str, Any]) -> np.ndarray:
    """The states of recorded scans, ``[T - 1, N, size]``."""
    recorded = {key: value.double().numpy() for key, value in scans.items()}
    steps, vehicles = recorded["cloud"].shape[:2]
    found = np.zeros((steps - 1, vehicles, terms["state"]["size"]))
    for vehicle in range(vehicles):
        observations: list[np.ndarray] = []
        for step in range(steps - 1):
            altitude, heading, elevation = (recorded[key][step, vehicle] for key in READ)
            pose = {"altitude": altitude, "heading": heading, "elevation": elevation}
            acted = recorded["action"][step - 1, vehicle] if step else np.zeros(4)
            cells = cell_values(recorded["cloud"][step, vehicle], terms)
            observations.append(observation({"cells": cells, "last_action": acted, **pose}, terms))
            found[step, vehicle] = state(observations, terms)
    return found


@pytest.mark.parametrize("reduction", ["truncated_icosahedron", "range_image"])
@pytest.mark.parametrize(
    ("statistic", "angles", "last_action", "frames"),
    [("face", "folded", False, 3), ("range", "raw", True, 4), ("proximity", "turns", True, 1)],
)
def test_states_of_recorded_scans_follow_from_the_contract(
    reduction: str, statistic: str, angles: str, last_action: bool, frames: int
) -> None:
    settings, terms = derived(
        f"perception={reduction}",
        *(f"perception.{key}={value}" for key, value in [("statistic", statistic), ("angles", angles)]),
        *(f"perception.{key}={value}" for key, value in [("last_action", last_action), ("frames", frames)]),
        "perception.radius=3.5",
        "env.world.flight_level=3.0",
    )
    scans = load_file(SCANS)
    seen = states({key: scans[key] for key in ("cloud", "action", *READ)}, settings.perception)
    expected = rebuilt(scans, terms)
    assert (expected[..., : terms["cells"]["count"]] != 0).any() or frames > 1
    np.testing.assert_allclose(seen.numpy(), expected, atol=2e-5 if angles != "raw" else 1e-4)


def test_the_grid_of_a_range_image_is_in_the_contract() -> None:
    """And nothing new is in that of the default one, which other versions read."""
    grid = "perception.grid={columns:36,rows:4,elevation:[-24,16]}"  # no border is at a laser of the recording
    settings, terms = derived("perception=range_image", grid, "perception.statistic=face", "perception.frames=1")
    cells = terms["cells"]
    named = {key: cells[key] for key in ("columns", "rows", "width", "elevation", "row_borders", "count")}
    borders = [-14.0, -4.0, 6.0]
    assert named == {
        "columns": 36,
        "rows": 4,
        "width": 10,
        "elevation": [-24, 16],
        "row_borders": borders,
        "count": 144,
    }
    scans = load_file(SCANS)
    seen = states({key: scans[key] for key in ("cloud", "action", *READ)}, settings.perception)
    np.testing.assert_allclose(seen.numpy(), rebuilt(scans, terms), atol=2e-5)
    assert "elevation" not in derived("perception=range_image")[1]["cells"]
    read = Cells.model_validate_json(json.dumps(cells))
    assert read.grid == RangeGrid(36, 4, (-24.0, 16.0))
    with pytest.raises(ValidationError, match="borders between them, all ascending"):
        Cells.model_validate_json(json.dumps({**cells, "row_borders": [5.0, -5.0, 0.0]}))


def flown(settings: TrainConfig) -> tuple[dict[str, Tensor], dict[str, Tensor], NavigationEnv]:
    """Scans of one vehicle that flies forward, left and round, their poses by the contract, and the vehicle."""
    base = NavigationEnv(1, world=settings.env.world, seed=3)
    action = torch.tensor([[2.0, 1.0, 0.0, 0.5]])
    data, rows, poses = base.reset(), [], []
    for _ in range(SCANNED):
        (x, y, z), (goal_x, goal_y, goal_z) = base.simulation.position[0], data["goal"][0].double().tolist()
        heading = np.degrees(np.arctan2(goal_y - y, goal_x - x) - base.simulation.yaw[0]) % 360
        elevation = np.degrees(np.arctan2(goal_z - z, np.hypot(goal_x - x, goal_y - y))) % 360
        poses.append(dict(zip(READ, (torch.tensor([[value]]) for value in (z, heading, elevation)), strict=True)))
        cloud = data["point_cloud"][0, ::9]
        cloud = torch.where(unmistakable(cloud)[:, None], cloud, torch.nan)
        rows.append({"cloud": cloud[None], "action": action, **{key: data[key] for key in READ}})
        data = base.step(data.set("action", action))["next"].set("goal", data["goal"])
    stacked = [{key: torch.stack([row[key] for row in each]) for key in each[0]} for each in (rows, poses)]
    return stacked[0], stacked[1], base


@pytest.mark.parametrize("overrides", [(), ("preset=dagger", "env.world.seeds=[0]")])
def test_a_flight_follows_from_the_contract(overrides: tuple[str, ...]) -> None:
    """The pose of a simulated vehicle, the scan that tilts with it, and where its action leads."""
    settings, terms = derived(*overrides, *VALLEY)
    scans, poses, base = flown(settings)
    seen = states(scans, settings.perception)
    assert seen.shape[-1] == terms["state"]["size"] and (seen[..., -40:-7] != 0).any()
    np.testing.assert_allclose(seen.numpy(), rebuilt(scans | poses, terms), atol=2e-5)
    yaw, velocity = base.simulation.yaw[0], base.simulation.velocity[0]
    forward = velocity[0] * np.cos(yaw) + velocity[1] * np.sin(yaw)
    left = velocity[1] * np.cos(yaw) - velocity[0] * np.sin(yaw)
    assert base.simulation.rotation[0, 2, 2] < 0.999, "it is tilted"
    assert forward > left > 0.1 and base.simulation.angular_velocity[0, 2] > 0.1
    base.close()


def test_it_says_what_else_a_program_needs() -> None:
    _, terms = derived("preset=dagger", "perception.blind=true", "env.airframe.lidar_position=[0.0,0.0,0.2]")
    assert terms["rate_hz"] == 10 and terms["weights_sha256"] == "0" * 64
    assert terms["cloud"]["blind"] is True and terms["cloud"]["sensor_position"] == [0.0, 0.0, 0.2]
    assert terms["action"]["order"] == ["l_x", "l_y", "l_z", "a_z"]
    assert [unit.split(",")[0] for unit in terms["action"]["unit"]] == ["m/s", "m/s", "m/s", "rad/s"]
    assert terms["action"]["high"] == [2.0] * 4 and terms["action"]["low"] == [-2.0] * 4
    assert {"commit", "python", "uavrl", "torch", "torchrl", "tensordict"} <= terms["versions"].keys()
    assert [entry["name"] for entry in terms["observation"]] == [
        *("cells", "altitude", "heading", "elevation", "last_action")
    ]


def test_what_is_not_of_the_valley_has_none() -> None:
    assert contract(validate(compose("perception=none")), "") is None


def test_a_contract_names_the_sensor_and_the_speed_of_the_training() -> None:
    slow, fast = (derived("preset=dagger", *told)[1] for told in ((), ("env.lidar=mid360", "env.max_speed=6")))
    assert slow["cloud"]["lidar"]["name"] == "vlp16"
    assert slow["cloud"]["lidar"]["field_of_view"] == [-180.0, 180.0, -15.0, 15.0]
    assert slow["cloud"]["sensor"].startswith("one revolution of a Velodyne VLP-16")
    assert slow["action"]["high"] == [2.0, 2.0, 2.0, 2.0]
    assert fast["cloud"]["lidar"]["name"] == "mid360" and "mid360" in fast["cloud"]["sensor"]
    assert fast["cloud"]["lidar"]["field_of_view"] == [-180.0, 180.0, -7.0, 52.0]
    assert slow["cloud"]["lidar"]["cells_see"] == [-180.0, 180.0, -15.0, 15.0] and slow["cloud"]["lidar"]["repeats"]
    assert fast["cloud"]["lidar"]["cells_see"] == [-180.0, 180.0, -15.0, 52.0] and not fast["cloud"]["lidar"]["repeats"]
    assert fast["action"]["high"] == [6.0, 6.0, 6.0, 2.0] and fast["action"]["low"] == [-6.0, -6.0, -6.0, -2.0]
    assert fast["cells"]["radius"] == 6.0
    last = next(entry for entry in fast["observation"] if entry["name"] == "last_action")
    assert last["divisor"] == 6.0
    terms = Contract.model_validate_json(json.dumps(fast))
    assert terms.contradiction() is None
    assert (terms.vehicle.velocity_limit, terms.vehicle.yaw_rate_limit) == (6.0, 2.0)
