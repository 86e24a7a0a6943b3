"""A policy that was trained with a map of its episode, outside of its training: its contract, and who leads it."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torchrl.envs import Transform

from tests.helpers.exported import exported, refusal
from uavrl.config import EvaluateConfig, compose, validate
from uavrl.config.parts import Part
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.guarded import GuardedPolicy
from uavrl.evaluation.policies import choose
from uavrl.export.export import contract
from uavrl.transforms import Waypoint
from uavrl_onboard.autopilot.dry_run import DryRun
from uavrl_onboard.flight.loop import Flight, map_for
from uavrl_onboard.flight.safety import SafetyLayer
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.policy.contract import read_contract
from uavrl_onboard.policy.policy import Policy

WALL = np.stack(np.broadcast_arrays(2.0, np.linspace(-1.0, 3.0, 40), -0.1), -1)
LEARNED = ("algo.hidden=[16]", "perception=range_image", "perception.memory=10", "env.world.flight_level=3.0")
TRAPS = ("env.world.traps=3", "env.world.obstacles=20")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("exported"), *LEARNED)


@pytest.fixture(scope="module")
def terms(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "contract.json").read_text())


def test_the_contract_says_what_stands_in_place_of_the_heading_and_how_it_is_found(terms: dict[str, Any]) -> None:
    names = [entry["name"] for entry in terms["observation"]]
    assert names == ["cells", "altitude", "waypoint", "elevation"]
    told = {key: value for key, value in terms["memory"].items() if key != "found"}
    assert told == {"sight": 10.0, "reach": 40.0, "cell": 0.25, "level": 0.4, "every": 5, "ahead": 4.0}
    assert "memory.found" in terms["pose"]["waypoint"]


def test_its_inputs_are_printed_as_a_table(folder: Path) -> None:
    example = runpy.run_path(str(Path(__file__).parents[2] / "docs/figures/inputs_table.py"))
    (row,) = (row for row in example["table"](folder / "contract.json").splitlines() if "waypoint" in row)
    assert row.startswith("| 73 | waypoint; degrees in [0, 360)")


def test_in_the_simulator_it_reads_what_its_training_did(folder: Path) -> None:
    """Vehicles fly straight on into traps; an exported policy reads there what its training's perception made."""
    told = [f"policy={folder}", *TRAPS]
    config = compose(*told, name="evaluate")
    setup = choose(validate(config, EvaluateConfig), config, told, None, torch.device("cpu"))
    assert isinstance(setup.policy, GuardedPolicy) and setup.policy.led, (
        "which shows it the heading to the waypoint as the goal's"
    )
    assert setup.perception["memory"] == 10.0
    env, policies = make_env(setup.env, setup.perception, num_uavs=2, keep_cloud=True, seed=0), [Policy(folder)]
    policies.append(policies[0].copy())
    data, turns = env.reset(), 0.0
    for _ in range(25):
        for number, policy in enumerate(policies):
            pose = (float(data[key][number, 0]) for key in ("altitude", "waypoint_deg", "elevation_deg"))
            seen = policy.state(data["point_cloud"][number].numpy(), *pose)
            np.testing.assert_allclose(seen, data["observation"][number].numpy(), rtol=0, atol=2e-6)
        apart = (data["waypoint_deg"] - data["heading_deg"] + 180) % 360 - 180
        turns = max(turns, float(apart.abs().max()))
        data = env.step_mdp(env.step(data.set("action", torch.tensor([[2.0, 0.0, 0.0, 0.0]] * 2))))
    assert turns > 5.0, "somewhere both differ"
    env.close()


def test_a_flight_leads_it_by_a_map_that_looks_as_far(folder: Path) -> None:
    """A wall of 4 m stands 2 m ahead; the goal is 20 m ahead."""
    headings = []

    class Noted(Policy):
        def __call__(self, *told: Any) -> np.ndarray:
            headings.append(told[2])
            return super().__call__(*told)

    policy = Noted(folder)
    for led in (None, map_for(policy.contract, 1.5)):
        flight = Flight(policy, (20.0, 0.0, 2.5), DryRun((0.0, 0.0, 3.0)), SafetyLayer(), memory=led)
        flight.step(0.0, Scan(0.0, WALL, len(WALL), 0))
    assert 290.0 < headings[0] < 340.0, "to the right of the wall"
    assert headings[1] == 0.0, "the map that is given looks less far than the wall"


def test_the_map_is_of_the_policys_training(folder: Path) -> None:
    contract = read_contract(folder)
    trained, shorter = map_for(contract), map_for(contract, 4.0)
    assert trained is not None and (trained.sight, trained.flight_level) == (10.0, 3.0)
    assert shorter is not None and shorter.sight == 4.0
    assert map_for(contract.model_copy(update={"memory": None})) is None


def test_of_a_blind_policy_the_map_stays_empty(folder: Path) -> None:
    """In its training it saw misses alone."""
    contract = read_contract(folder)
    blind = contract.model_copy(update={"cloud": contract.cloud.model_copy(update={"blind": True})})
    assert map_for(blind) is None


def test_in_training_the_lidar_is_where_the_airframe_has_it(tmp_path: Path) -> None:
    mounted = (*LEARNED, "env.airframe.lidar_position=[0.0,0.0,-0.3]")
    settings = validate(compose(*mounted))
    env = make_env(settings.env, settings.perception, num_uavs=1, seed=0)
    (led,) = (part for part in env.transform.modules() if isinstance(part, Waypoint))
    env.close()
    flown = map_for(read_contract(exported(tmp_path, *mounted)))
    assert flown is not None
    assert led.sensor_position == tuple(flown.sensor_position) == (0.0, 0.0, -0.3)


class Mounted(Transform):
    """Somebody's perception that must be told where the LiDAR is."""

    def __init__(self, sensor_position: Sequence[float]) -> None:
        super().__init__()


def test_perception_that_asks_where_the_lidar_is_can_be_exported() -> None:
    own = Part(_target_=f"{__name__}.Mounted")
    assert contract(replace(validate(compose()), perception=own, packages=["tests"]), "") is None


def _set(key: str, to: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda terms: terms["memory"].update({key: to})


DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no part": (lambda terms: terms.pop("memory"), "observation has other quantities or scales"),
    "the goal's heading": (
        lambda terms: terms["observation"][2].update(name="heading"),
        "observation has other quantities or scales",
    ),
    "no sight": (_set("sight", -1.0), "memory.sight: Input should be greater than 0"),
    "another cell": (_set("cell", 0.5), "memory is another map"),
    "another reach": (_set("reach", 20.0), "memory is another map"),
    "seldom": (_set("every", 50), "memory is another map"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_contract_that_does_not_hold_together_is_refused(name: str, terms: dict[str, Any], tmp_path: Path) -> None:
    change, told = DAMAGES[name]
    assert told in refusal(tmp_path, terms, change)
