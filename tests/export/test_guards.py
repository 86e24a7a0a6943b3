"""The guards that a contract names: what another program reads there, and what is refused."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torchrl.envs import Transform

from tests.helpers.exported import edit_contract, exported, refusal
from uavrl.config import compose, validate
from uavrl.config.parts import Part
from uavrl.export.export import contract
from uavrl_onboard.autopilot.dry_run import DryRun
from uavrl_onboard.flight.loop import Flight
from uavrl_onboard.flight.safety import SafetyLayer
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.settings import GuardSettings, guard_settings
from uavrl_onboard.guards.shield import Shield, closing_speeds, sight_at
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.policy.contract import read_contract
from uavrl_onboard.policy.contract_parts import GuardTerms
from uavrl_onboard.policy.policy import Policy
from uavrl_onboard.vehicle import Vehicle

WALL = np.stack(np.broadcast_arrays(2.0, np.linspace(-1.0, 3.0, 40), -0.1), -1)
LEARNED = ("algo.hidden=[16]", "perception=range_image", "env.world.flight_level=3.0")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = exported(tmp_path_factory.mktemp("exported"), *LEARNED)
    guards = GuardTerms.of(guard_settings(["all", {"shield": {"margin": 0.2}}]), Vehicle(radius=0.4))
    assert guards is not None
    edit_contract(made, lambda terms: terms.update(guards=guards.model_dump(mode="json")))
    return made


@pytest.fixture(scope="module")
def terms(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "contract.json").read_text())


def test_the_contract_names_guards_with_their_settings_and_the_hull(folder: Path, terms: dict[str, Any]) -> None:
    said = terms["guards"]
    numbers = {
        name: {key: v for key, v in said[name].items() if key != "does"} for name in ("map", "evasion", "shield")
    }
    assert numbers == {
        "map": {"sight": 12.0, "reach": 40.0, "cell": 0.25, "level": 0.4, "every": 5, "ahead": 4.0},
        "evasion": {"sight": 12.0, "objects": 3},
        "shield": {"time": 0.7, "lag": 0.3, "margin": 0.2},
    }
    assert (said["radius"], said["height"]) == (0.4, 0.28) and "map, evasion, shield" in said["applied"]
    read = read_contract(folder)
    assert read.guard_settings == guard_settings(["all", {"shield": {"margin": 0.2}}])
    assert read.vehicle.hull == (0.4, 0.14) and read.vehicle.flight_level == 3.0


def test_the_contract_explains_the_shield_as_it_acts(terms: dict[str, Any]) -> None:
    """Its two formulas for a vehicle above 2 m/s give what the shield uses, with a gap in m."""
    said = terms["guards"]["shield"]["does"].replace("²", "**2")
    farthest, fastest = (
        re.findall(pattern, said)[0] for pattern in (r"points count within (.*?) m, and", r"(sqrt\(.*\))$")
    )
    for v, gap in ((4.0, 5.0), (6.0, 8.0)):
        numbers = {"sqrt": math.sqrt, "time": 0.7, "gap": gap, "v": v}
        assert eval(farthest, numbers) == pytest.approx(sight_at(Shield.sight, v))
        assert eval(fastest, numbers) == pytest.approx(closing_speeds(np.array(gap), 0.7, v))
    assert f"within {Shield.sight:g} m, except" in said


def test_a_contract_without_guards_names_none() -> None:
    assert GuardTerms.of(GuardSettings(), Vehicle()) is None
    made = contract(validate(compose()), "")
    assert made is not None and made.guards is None and made.guard_settings == GuardSettings()
    assert '"guards"' not in made.to_text()


def test_a_flight_has_the_contracts_guards_unless_it_is_given_others(folder: Path) -> None:
    """A wall of 4 m stands 2 m ahead; the goal is 20 m ahead."""
    headings = []

    class Noted(Policy):
        def __call__(self, *told: Any) -> np.ndarray:
            headings.append(told[2])
            return super().__call__(*told)

    policy = Noted(folder)
    for guards in (None, Guards(GuardSettings())):
        flight = Flight(policy, (20.0, 0.0, 2.5), DryRun((0.0, 0.0, 3.0)), SafetyLayer(), guards=guards)
        flight.step(0.0, Scan(0.0, WALL, len(WALL), 0))
    assert 290.0 < headings[0] < 340.0, "to the right of the wall"
    assert headings[1] == 0.0


class Mounted(Transform):
    """Somebody's perception that must be told where the LiDAR is."""

    def __init__(self, sensor_position: Sequence[float]) -> None:
        super().__init__()


def test_perception_that_asks_where_the_lidar_is_can_be_exported() -> None:
    own = Part(_target_=f"{__name__}.Mounted")
    assert contract(replace(validate(compose()), perception=own, packages=["tests"]), "") is None


def _set(guard: str, key: str, to: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda terms: terms["guards"][guard].update({key: to})


DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no hull": (lambda terms: terms["guards"].pop("radius"), "guards.radius: Field required"),
    "no sight": (_set("map", "sight", -1.0), "guards.map.sight: Input should be greater than 0"),
    "no time": (_set("shield", "time", 0.0), "guards.shield.time: Input should be greater than 0"),
    "no object": (_set("evasion", "objects", 0), "guards.evasion.objects: Input should be greater than or equal to 1"),
    "another cell": (_set("map", "cell", 0.5), "guards.map is another map"),
    "another reach": (_set("map", "reach", 20.0), "guards.map is another map"),
    "seldom": (_set("map", "every", 50), "guards.map is another map"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_contract_that_does_not_hold_together_is_refused(name: str, terms: dict[str, Any], tmp_path: Path) -> None:
    change, told = DAMAGES[name]
    assert told in refusal(tmp_path, terms, change)
