"""An exported policy that sees motion: its inputs by the contract alone, its actions among planes, what it refuses."""

from __future__ import annotations

import json
import runpy
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from tests.helpers.commands import VALLEY
from tests.helpers.exported import edit_contract, exported, refusal
from uavrl.config import validate
from uavrl.evaluation.actor import read_policy
from uavrl.evaluation.environment import make_env
from uavrl.export.simulated import ExportedPolicy
from uavrl_onboard.autopilot.dry_run import DryRun
from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.loop import Flight
from uavrl_onboard.flight.safety import SafetyLayer, SafetyState
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.policy.policy import Policy

SEES = ("perception=range_image", "perception.last_action=true", "perception.motion=12", "algo.hidden=[16,8]")
WORLD = (*VALLEY, "env.world.seeds=[0]", "env.world.planes=4", "env.world.plane_keep_out=2")
STEPS, CELLS = 9, 72
OBJECTS, THREATS = slice(75, 96), slice(96, 169)
LEVEL = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))  # velocity and attitude


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("exported"), *SEES, *WORLD)


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(made, tmp_path / "exported"))


@pytest.fixture(scope="module")
def terms(made: Path) -> dict[str, Any]:
    return json.loads((made / "contract.json").read_text())


@pytest.fixture(scope="module")
def flown(made: Path) -> list[TensorDictBase]:
    """What the simulator emits to three vehicles that the policy flies among planes, and its actions."""
    policy = read_policy(made)
    settings = validate(policy.config)
    options: dict[str, Any] = {"num_uavs": 3, "keep_cloud": True, "mark_resets": True}
    env = make_env({**settings.env, "max_steps": 2 * STEPS}, settings.perception, seed=3, **options)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        steps = list(_steps(env, policy))
    env.close()
    assert (steps[-1]["moving_objects"].reshape(3, 3, 7)[..., 6] > 0).any(), "something moves"
    return steps


def _steps(env: TransformedEnv, policy: Callable[[TensorDictBase], TensorDictBase]) -> Iterator[TensorDictBase]:
    state = env.reset()
    for _ in range(STEPS):
        yield (acted := policy(state).clone())
        state = env.step(acted)["next"]


def test_it_acts_in_the_simulator_as_the_run_does(made: Path, flown: list[TensorDictBase]) -> None:
    policy = ExportedPolicy(made)
    for _ in range(2):  # an episode leaves nothing behind
        for step in flown:
            acted = policy(step.select(*policy.in_keys))["action"]
            np.testing.assert_allclose(acted.numpy(), step["action"].numpy(), rtol=0, atol=1e-5)
    assert policy.overrides["perception.motion"] == 12.0


def read(policy: Policy, step: TensorDictBase, vehicle: int, cloud: np.ndarray | None = None) -> np.ndarray:
    """What a policy reads of a step, its newest observation."""
    cloud = step["point_cloud"][vehicle].numpy() if cloud is None else cloud
    goal = (float(step[key][vehicle, 0]) for key in ("altitude", "heading_deg", "elevation_deg"))
    own = (step[key][vehicle].numpy() for key in ("velocity", "attitude"))
    return policy.state(cloud, *goal, *own).reshape(3, -1)[-1]


def test_it_reads_of_points_in_any_order_what_the_simulator_told(made: Path, flown: list[TensorDictBase]) -> None:
    rng, policy = np.random.default_rng(0), Policy(made)
    for vehicle in range(3):
        policy.reset()
        for step in flown:
            cloud = step["point_cloud"][vehicle].numpy()
            seen = read(policy, step, vehicle, rng.permutation(cloud[np.isfinite(cloud).all(1)]))
            told = step["observation"][vehicle].reshape(3, -1)[-1].numpy()
            np.testing.assert_allclose(seen[:-4], told[:-4], rtol=0, atol=2e-6)


def test_threats_follow_from_the_contract_and_numpy(terms: dict[str, Any], flown: list[TensorDictBase]) -> None:
    part, entries = terms["motion"]["threats"], {entry["name"]: entry for entry in terms["observation"]}
    times = part["period"] * np.arange(1, part["steps"] + 1)
    lost, share = part["lag"] * (1 - np.exp(-times / part["lag"])), times / times[-1]
    greatest = 0.0
    ways = part["speed"] * np.array([*part["directions"], [0.0] * 3])
    for step in flown:
        for vehicle in range(3):
            (vx, vy, vz), yaw = step["velocity"][vehicle].tolist(), float(step["attitude"][vehicle, 2])
            own = np.array([np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx, vz])
            worst = np.zeros(len(ways))
            objects = step["moving_objects"][vehicle].double().numpy().reshape(terms["motion"]["objects"], -1)
            for body in objects[objects[:, 6] > 0]:
                path = ways[:, None] * (times - lost)[:, None] + own * lost[:, None]
                x, y, z = np.moveaxis(path - body[:3] - body[3:6] * times[:, None], -1, 0)
                apart = np.maximum(np.hypot(x, y) / part["wide"], np.abs(z) / part["high"])
                soon = np.maximum(1.2 - 0.2 * share - apart, 0) * (1 - 0.5 * share)
                worst = np.maximum(worst, soon.max(1) + (apart < 1).any(1))
            greatest = max(greatest, worst.max())
            told = step["observation"][vehicle].reshape(3, -1)[-1].numpy()
            np.testing.assert_allclose(told[THREATS], worst / entries["threats"]["divisor"], rtol=0, atol=1e-5)
            scaled = objects.ravel() / entries["moving_objects"]["divisor"]
            np.testing.assert_allclose(told[OBJECTS], scaled, rtol=0, atol=1e-6)
    assert greatest > 0.5


def test_the_contract_says_where_it_stands_and_what_it_is(terms: dict[str, Any]) -> None:
    names = [entry["name"] for entry in terms["observation"]]
    assert names == [*("cells", "altitude", "heading", "elevation", "moving_objects", "threats", "last_action")]
    motion = terms["motion"]
    assert (motion["max_range"], motion["objects"], motion["period"]) == (12.0, 3, 0.1)
    assert len(motion["object"]) == 7 and motion["rays"]["every"] == 5
    assert {"velocity", "attitude", "moving_objects", "threats"} <= terms["pose"].keys()


def test_its_inputs_are_printed_as_a_table(made: Path) -> None:
    example = runpy.run_path(str(Path(__file__).parents[3] / "docs/figures/inputs_table.py"))
    table = example["table"](made / "contract.json")
    objects, threats = (
        next(row for row in table.splitlines() if name in row) for name in ("moving objects", "threats;")
    )
    assert objects.startswith("| 75–95 | the nearest 3 moving objects, each forward (m), left (m)")
    assert objects.endswith("| each object's values / 12, 12, 12, 5, 5, 5, 2.5 |")
    assert threats.startswith("| 96–168 |") and threats.endswith("| value / 2.2 |")


def test_a_reset_and_a_copy_have_seen_nothing(made: Path, flown: list[TensorDictBase]) -> None:
    vehicle = int((flown[-1]["moving_objects"].reshape(3, 3, 7)[:, 0, 6] > 0).nonzero()[0, 0])
    policy = Policy(made)
    for step in flown:
        seen = read(policy, step, vehicle)
    other = policy.copy()
    assert seen[OBJECTS].any() and not read(other, flown[-1], vehicle)[OBJECTS].any()
    assert read(policy, flown[-1], vehicle)[OBJECTS].any(), "the copy's memory is its own"
    policy.reset()
    for step in flown[-2:]:
        assert not read(policy, step, vehicle)[OBJECTS].any()


def test_the_blind_see_nothing_move(folder: Path, flown: list[TensorDictBase]) -> None:
    edit_contract(folder, lambda terms: terms["cloud"].update(blind=True))
    policy = Policy(folder)
    seen = np.array([read(policy, step, 0) for step in flown])
    assert not seen[:, :CELLS].any() and not seen[:, OBJECTS].any() and not seen[:, THREATS].any()


@pytest.mark.parametrize(
    "told",
    [
        (),
        ((0.0, 0.0, 0.0),),
        ((np.nan, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (np.inf, 0.0, 0.0)),
        ((0.0, 0.0), (0.0, 0.0, 0.0)),
    ],
)
def test_without_velocity_and_attitude_it_refuses_and_nothing_changes(made: Path, told: tuple[Any, ...]) -> None:
    policy, other, cloud = Policy(made), Policy(made), np.full((1, 3), np.nan)
    with pytest.raises(UavrlError, match=r"needs velocity .* and attitude .*: fly it by what tells both") as caught:
        policy(cloud, 3.0, 0.0, 0.0, *told)
    assert "\n" not in str(caught.value)
    with pytest.raises(UavrlError, match="points must be"):
        policy(np.zeros((4, 2)), 3.0, 0.0, 0.0, *LEVEL)
    np.testing.assert_array_equal(policy(cloud, 3.0, 0.0, 0.0, *LEVEL), other(cloud, 3.0, 0.0, 0.0, *LEVEL))


class Link(DryRun):
    """A vehicle that does not tell its velocity until it is asked to."""

    velocity = (np.nan, np.nan, np.nan)

    def pose(self) -> Pose:
        return replace(super().pose(), velocity=self.velocity)


def test_it_does_not_take_off_by_what_tells_no_velocity(made: Path, caplog: pytest.LogCaptureFixture) -> None:
    link = Link((0.0, 0.0, 3.5))
    flight = Flight(Policy(made), (20.0, 0.0, 2.5), link, SafetyLayer())
    states = []
    for step in range(40):
        link.velocity = (np.nan,) * 3 if step < 25 else (0.0, 0.0, 0.0)
        now = 100.0 + 0.1 * step
        link.receive(now)
        states.append(flight.step(now, Scan(now, np.ones((1, 3), np.float32), 1, 0)).status)
    assert SafetyState.FLYING not in [status.state for status in states[:25]] and states[-1].state is SafetyState.FLYING
    told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(told) == 1 and told[0].startswith("The policy gives no action: This policy sees what moves"), told


def test_a_lost_scan_makes_nothing_fly_faster(made: Path) -> None:
    """A ball at 3 m/s, 6 m ahead."""
    ring = np.linspace(-0.3, 0.3, 31)
    ball = np.stack(np.broadcast_arrays(6.0, ring[:, None], ring), -1).reshape(-1, 3)
    policy, last = Policy(made), 0
    for step in (0, 1, 2, 3, 4, 5, 7, 8):
        seen = policy.state(ball + np.array([0.0, 0.3 * step, 0.0]), 3.5, 0.0, 0.0, *LEVEL, 0.1 * (step - last) or None)
        last = step
        if step > 5:
            velocity = seen.reshape(3, -1)[-1][OBJECTS][3:6] * 5.0
            np.testing.assert_allclose(velocity, [0.0, 3.0, 0.0], atol=0.3)
    for wrong in (0.0, -0.1, np.nan, np.inf):
        with pytest.raises(UavrlError, match="elapsed must be a finite time above 0 s"):
            policy(ball, 3.5, 0.0, 0.0, *LEVEL, wrong)


def _set(*path: Any, to: Any) -> Callable[[dict[str, Any]], None]:
    def change(terms: Any) -> None:
        for key in path[:-1]:
            terms = terms[key]
        terms[path[-1]] = to

    return change


def _exchange(terms: dict[str, Any]) -> None:
    entries = terms["observation"]
    entries[4], entries[5] = entries[5], entries[4]


DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no part": (lambda terms: terms.pop("motion"), "observation has other quantities or scales"),
    "no threats": (lambda terms: terms["motion"].pop("threats"), "(motion.threats: Field required)"),
    "another range": (_set("motion", "max_range", to=8.0), "observation has other quantities or scales"),
    "no range": (_set("motion", "max_range", to=-1.0), "motion.max_range: Input should be greater than"),
    "many objects": (_set("motion", "objects", to=10**9), "motion.objects: Input should be less than or equal to 100"),
    "another number": (_set("motion", "objects", to=2), "observation has other quantities or scales"),
    "another period": (_set("motion", "period", to=0.2), "motion.period is not that of rate_hz"),
    "other rays": (_set("motion", "rays", "every", to=4), "motion.rays are others"),
    "other threats": (_set("motion", "threats", "wide", to=2.0), "motion.threats are made otherwise"),
    "turned ways": (_set("motion", "threats", "directions", 0, to=[0.0, 1.0, 0.0]), "motion.threats are made"),
    "fewer ways": (_set("motion", "threats", "directions", to=[[1.0, 0.0, 0.0]]), "motion.threats are made"),
    "no list": (_set("observation", 4, "divisor", to=12.0), "observation has other quantities or scales"),
    "a list": (_set("observation", 1, "divisor", to=[3.5]), "observation has other quantities or scales"),
    "divided by 0": (_set("observation", 4, "divisor", 3, to=0.0), "(observation.4.divisor: Input should be "),
    "exchanged": (_exchange, "observation has other quantities or scales"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_contract_that_does_not_hold_together_is_refused(name: str, folder: Path, terms: dict[str, Any]) -> None:
    change, told = DAMAGES[name]
    assert told in refusal(folder, terms, change)
