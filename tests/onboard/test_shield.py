"""A shield lets through what is safe, and of the rest what is left when the way to the obstacle is taken out of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch.testing import assert_close

from tests.helpers.commands import in_process
from uavrl.cli import evaluate
from uavrl.envs import NavigationEnv
from uavrl.envs.world import WorldConfig
from uavrl.evaluation.guarded import GuardedPolicy
from uavrl.evaluation.rollout import rollout_episodes
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.shield import Shield, fitted
from uavrl_onboard.vehicle import Vehicle

LEVEL = (0.0, 0.0)
STILL = np.zeros(3)
FAST = np.array([2.0, 0.0, 0.0])


def at_hulls_height(*places: tuple[float, float]) -> np.ndarray:
    """Points as the LiDAR sees them, which sits 0.1 m over the hull's middle."""
    return np.array([[x, y, -0.1] for x, y in places])


@pytest.mark.parametrize(
    ("gap", "speed"), [(2.0, 2.0), (1.52, 2.0), (0.82, 1.0), (0.47, 0.5), (0.12, 0.0), (0.05, 0.0)]
)
def test_the_gap_less_the_margin_is_closed_in_seven_tenths_of_a_second_at_the_earliest(
    gap: float, speed: float
) -> None:
    found = Shield()(FAST, at_hulls_height((0.35 + gap, 0.0)), LEVEL, STILL)
    assert found == pytest.approx([speed, 0.0, 0.0], abs=1e-6)


def test_what_is_safe_is_flown_as_it_is_asked_for() -> None:
    asked = np.array([-2.0, 0.3, 1.0])
    for cloud in (np.full((4, 3), np.nan), np.zeros((3, 3)), np.zeros((0, 3)), np.full((1, 3), np.inf)):
        assert Shield()(asked, cloud, LEVEL, STILL).tolist() == asked.tolist()
    assert Shield()(asked, at_hulls_height((0.5, 0.0)), LEVEL, STILL).tolist() == asked.tolist()  # away from it


def test_a_vehicle_that_flies_on_for_a_moment_has_less_of_the_gap() -> None:
    ahead = at_hulls_height((0.35 + 1.42, 0.0))
    assert Shield()(FAST, ahead, LEVEL, np.array([1.0, 0.0, 0.0])) == pytest.approx([1.0 / 0.7, 0.0, 0.0], abs=1e-6)
    assert Shield()(FAST, ahead, LEVEL, np.array([-1.0, 0.0, 0.0])) == pytest.approx([1.3 / 0.7, 0.0, 0.0], abs=1e-6)


def test_along_a_wall_it_flies_on() -> None:
    wall = at_hulls_height(*((x, 1.0) for x in np.linspace(-2, 2, 41)))
    forward, left, up = Shield()(np.array([1.5, 1.5, 0.0]), wall, LEVEL, STILL)
    assert forward > 0.9 and 0.0 < left < 0.8 and up == pytest.approx(0.0, abs=1e-6)


def test_in_a_corner_it_stands() -> None:
    ends = np.linspace(-0.4, 0.4, 9)
    corner = at_hulls_height(*((0.47, y) for y in ends), *((x, 0.47) for x in ends))
    assert np.abs(Shield()(np.array([2.0, 2.0, 0.0]), corner, LEVEL, STILL)).max() < 0.15


def test_the_hull_is_flat() -> None:
    above, up = np.array([[0.0, 0.0, 0.51]]), np.array([0.0, 0.0, 2.0])  # 0.61 over the middle, 0.47 over the hull
    assert Shield()(up, above, LEVEL, STILL)[2] == pytest.approx((0.61 - 0.26) / 0.7)


def test_a_tilted_sensor_sees_what_is_level() -> None:
    """At a pitch of 0.3 rad nose down, what is straight ahead stands above the sensor's own horizon."""
    pitch, roll = 0.3, 0.2
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    body_to_level = about_y @ about_x
    seen = (body_to_level.T @ np.array([0.82 + 0.35, 0.0, 0.0]) - [0.0, 0.0, 0.1])[None]
    assert Shield()(FAST, seen, (roll, pitch), STILL) == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


def test_whatever_stands_around_nothing_is_approached_too_fast() -> None:
    rng, shield = np.random.default_rng(0), Shield()
    for _ in range(200):
        cloud, asked = rng.normal(0, 1.2, (rng.integers(1, 200), 3)), rng.uniform(-2, 2, 3)
        towards, speed = shield.bounds(cloud, LEVEL, STILL)
        found = fitted(asked, towards, speed)
        assert (towards @ found - speed).max(initial=0.0) <= 0.1 + 1e-9
        assert np.linalg.norm(found) <= np.linalg.norm(asked) + 1e-9


class Forward:
    """A policy from elsewhere that flies ahead, whatever it sees."""

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = torch.tensor([2.0, 0.0, 0.0, 0.5]).expand(*tensordict.batch_size, 4)
        return tensordict.set("action", action)


def test_behind_it_the_blind_do_not_collide() -> None:
    world = WorldConfig(size=(16.0, 14.0), obstacles=12, min_goal_distance=5.0, min_clearance=1.0)
    env = NavigationEnv(4, world=world, max_steps=60, measure_clearance=True)
    ends = [flight.outcome for flight in rollout_episodes(env, Forward(), 4)]
    env.set_seed(0)
    shielded = [flight.outcome for flight in rollout_episodes(env, GuardedPolicy(Forward(), shield=Shield()), 4)]
    assert ends.count("collided") > shielded.count("collided") == 0


def test_it_asks_for_what_policy_and_shield_read_and_leaves_the_yaw_rate() -> None:
    turning = TensorDictModule(lambda cells: cells.new_tensor([[3.0, 0.0, 0.0, -1.5]]), ["cells"], ["action"])
    shielded = GuardedPolicy(turning, shield=Shield(time=1.0))
    assert shielded.in_keys == ["cells", "point_cloud", "attitude", "velocity"]
    seen = TensorDict(cells=torch.zeros(1, 2), point_cloud=torch.tensor([[[0.85, 0.0, -0.1]]]), batch_size=[1])
    seen["attitude"] = seen["velocity"] = torch.zeros(1, 3)
    assert shielded(seen)["action"][0].tolist() == pytest.approx([0.38, 0.0, 0.0, -1.5], abs=1e-6)


def test_an_evaluation_flies_behind_a_shield_of_the_vehicles_own_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shields: set[Shield] = set()

    def stands(shield: Shield, asked: np.ndarray, *_: object) -> np.ndarray:
        shields.add(shield)
        return np.zeros(3)

    monkeypatch.setattr(Shield, "__call__", stands)
    output = tmp_path / "shielded.json"
    command = ["policy=straight", "shield=true", "episodes=2", "num_uavs=2", "env.max_steps=3", "progress=false"]
    assert in_process(evaluate.main, *command, "env.airframe.collision_radius=0.3", f"output={output}") == 0
    result = json.loads(output.read_text())
    assert "shield=true" in result["overrides"] and result["outcomes"] == "TT"
    assert max(flight["flown"] for flight in result["flights"]) < 0.2
    assert shields == {Shield(vehicle=Vehicle(radius=0.3))}


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"time": 0.0}, "time must be a finite number above 0, got 0.0"),
        ({"lag": float("nan")}, "lag must be a finite number of 0 or more, got nan"),
        ({"margin": -0.1}, "margin must be a finite number of 0 or more, got -0.1"),
        (
            {"vehicle": Vehicle(height=0.5)},
            "rim of a hull of radius 0.35 m and height 0.5 m sticks out .* margin of 0.12 m: raise margin",
        ),
    ],
)
def test_a_shield_that_bounds_nothing_is_refused(wrong: dict[str, Any], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        Shield(**wrong)


@pytest.mark.parametrize("place", range(4))
def test_numbers_that_are_none_are_refused(place: int) -> None:
    asked, cloud, tilt, velocity = FAST, at_hulls_height((1.0, 0.0)), LEVEL, STILL
    told = [asked, cloud, tilt, velocity]
    told[place] = [np.full(3, np.nan), np.zeros((3, 2)), (np.nan, 0.0), np.array([np.inf, 0.0, 0.0])][place]
    with pytest.raises(UavrlError, match=r"finite numbers|cloud \[points, 3\], got \[3, 2\]"):
        Shield()(*told)  # type: ignore[arg-type]


def test_of_a_sensor_that_sees_nothing_near_more_distance_is_kept() -> None:
    """What is 0.9 m from the sensor is about to vanish: nothing may be flown towards it."""
    assert Shield(nearest=0.9)(FAST, at_hulls_height((0.9, 0.0)), LEVEL, STILL)[0] == pytest.approx(0.0, abs=1e-6)
    assert Shield(nearest=0.3)(FAST, at_hulls_height((0.9, 0.0)), LEVEL, STILL)[0] > 0.5


def test_a_velocity_beyond_the_limit_keeps_its_direction() -> None:
    oblique = at_hulls_height(*((0.8 + 0.5 * y, y) for y in np.linspace(-1, 1, 21)))
    asked = np.array([2.0, -2.0, 0.0])
    free, limited = (
        Shield(vehicle=Vehicle(velocity_limit=most))(asked, oblique, LEVEL, STILL) for most in (100.0, 0.2)
    )
    assert np.abs(limited).max() == pytest.approx(0.2)
    assert limited / np.linalg.norm(limited) == pytest.approx(free / np.linalg.norm(free))


def test_the_vehicles_own_parts_are_no_obstacle() -> None:
    rotors = np.array([[0.2, 0.2, -0.1], [0.2, -0.2, -0.1], [-0.2, 0.2, -0.1], [-0.2, -0.2, -0.1]])
    assert Shield()(FAST, rotors, LEVEL, STILL).tolist() == FAST.tolist()


@pytest.mark.parametrize("batch", [[], [3], [2, 5], [0]])
def test_any_batch_flies_behind_it(batch: list[int]) -> None:
    ahead = TensorDictModule(lambda cells: cells + torch.tensor([2.0, 0.0, 0.0, 1.0]), ["cells"], ["action"])
    near = torch.tensor([[0.82 + 0.35, 0.0, -0.1]]).expand(*batch, 1, 3)
    seen = TensorDict(cells=torch.zeros(*batch, 4), point_cloud=near, batch_size=batch)
    seen["attitude"], seen["velocity"] = torch.zeros(*batch, 3), torch.zeros(*batch, 3)
    assert_close(
        GuardedPolicy(ahead, shield=Shield())(seen)["action"], torch.tensor([1.0, 0.0, 0.0, 1.0]).expand(*batch, 4)
    )


def test_a_policy_that_keeps_its_last_action_hears_what_is_flown() -> None:
    heard: list[list[float]] = []

    class Keeps(Forward):
        def flown(self, actions: np.ndarray) -> None:
            heard.extend(actions.tolist())

    seen = TensorDict(point_cloud=torch.tensor([[[0.82 + 0.35, 0.0, -0.1]]]), batch_size=[1])
    seen["attitude"] = seen["velocity"] = torch.zeros(1, 3)
    GuardedPolicy(Keeps(), shield=Shield())(seen)
    assert heard == [pytest.approx([1.0, 0.0, 0.0, 0.5], abs=1e-6)]
