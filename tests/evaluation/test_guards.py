"""``guards=`` wherever a policy flies: in an evaluation, in Python, in Gymnasium."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from tests.helpers.commands import in_process
from tests.helpers.exported import exported
from tests.helpers.flights import small_env
from uavrl import load_policy
from uavrl.cli import evaluate, export, sitl
from uavrl.config import compose, validate
from uavrl.config.settings import EvaluateConfig
from uavrl.envs import NavigationEnv
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import make_env, with_sight
from uavrl.evaluation.policies import PACKAGED, default_guards
from uavrl.evaluation.policy_setup import PolicySetup, choose
from uavrl.transforms import Guarded
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.guards.settings import GuardSettings, MapSettings, guard_settings
from uavrl_onboard.guards.shield import Shield
from uavrl_onboard.policy.contract import read_contract

ALL = ("map", "evasion", "shield")
VALLEY = "uavrl:uavrl/Valley-v0"


def chosen(*overrides: str, folder: Path | None = None) -> PolicySetup:
    config = compose(*overrides, name="evaluate")
    return choose(validate(config, EvaluateConfig), config, list(overrides), folder, torch.device("cpu"))


def guarded(env: Any) -> list[Guarded]:
    return [part for part in env.transform.modules() if isinstance(part, Guarded)]


def test_a_packaged_policy_flies_with_the_guards_of_its_contract_unless_others_are_asked_for() -> None:
    best, dynamic = (PACKAGED / name for name in ("best", "best_dynamic"))
    assert default_guards(best).names == ALL and default_guards(dynamic).names == ()
    assert chosen("policy=best", folder=best).guards == GuardSettings.all()
    assert chosen("policy=best", "guards=none", folder=best).guards == GuardSettings()
    changed = chosen("policy=best", "guards.shield.margin=0.2", folder=best)
    assert changed.guards.names == ALL and changed.guards.shield is not None and changed.guards.shield.margin == 0.2
    assert changed.source["guards"]["shield"]["margin"] == 0.2, "a result says what flew"
    some = chosen("policy=best", "guards=[map,shield]", "guards.map.sight=9", folder=best)
    assert some.guards.names == ("map", "shield") and some.guards.map == MapSettings(9.0)
    assert chosen("policy=straight").guards == GuardSettings()


def test_a_policy_in_python_has_them_too() -> None:
    policy = load_policy("best")
    small = ("env.world.obstacles=3", "randomize=none")
    for asked, names in ((None, ALL), ("none", ()), (["shield"], ("shield",))):
        env = policy.make_env(*small, guards=asked)
        assert [part.guards.names for part in guarded(env)] == ([names] if names else [])
        env.close()
    bare = load_policy("best", guards="none")
    env = bare.make_env(*small, "env.max_steps=3")
    assert not guarded(env) and env.rollout(2, bare)["action"].shape == (1, 2, 4)
    env.close()
    with pytest.raises(UavrlError, match="There is no guard 'typo'"):
        load_policy("best", guards="typo")


@pytest.mark.parametrize(("sight", "more", "reaches"), [(15, [], 15.0), (8, [], 12.0), (9, ["far_range=20"], 20.0)])
def test_a_policy_that_was_trained_to_look_less_far_looks_as_far_as_its_guards(
    sight: float, more: list[str], reaches: float
) -> None:
    overrides = ["policy=best_dynamic", "guards=[evasion]", f"guards.evasion.sight={sight}"]
    overrides += [f"perception.lidar.{each}" for each in more]
    setup = chosen(*overrides, folder=PACKAGED / "best_dynamic")
    assert setup.guards.evasion is not None and setup.guards.evasion.sight == sight
    env = make_env(setup.env, setup.perception, num_uavs=1, **setup.env_options)
    assert env.base_env.lidar_config.far_range == reaches
    env.close()


def test_a_sensor_that_does_not_reach_as_far_is_refused() -> None:
    seen = validate(compose("perception.lidar.far_range=8")).perception
    assert with_sight(seen, guard_settings(["map", {"map": {"sight": 8.0}}])) == seen
    with pytest.raises(UavrlError, match=r"guards.map.sight=12 looks farther than the LiDAR, which reaches 8 m"):
        make_env(small_env(), seen, guards=guard_settings("map"))


def test_a_range_that_nobody_gave_grows_with_what_looks_farther() -> None:
    overrides = ("perception.motion=15", "perception.lidar.far_range=20")
    guards, seen = guard_settings(["map"]), validate(compose(*overrides)).perception
    assert with_sight(seen, guards, given=[])["lidar"].far_range == 20.0, "what a run recorded does not shrink"
    seen["lidar"] = replace(seen.lidar, far_range=None)
    assert with_sight(seen, guards, given=[])["lidar"].far_range == 15.0, "perception looks farther than the map"
    seen["lidar"] = replace(seen.lidar, far_range=13.0)
    assert with_sight(seen, guards, given=[])["lidar"].far_range == 15.0
    with pytest.raises(UavrlError, match=r"perception\.motion=15 looks farther than the LiDAR, which reaches 13 m"):
        with_sight(seen, guards)


def test_an_evaluation_flies_with_guards_that_know_the_vehicle_and_look_as_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shields, reached = set[Any](), list[float]()
    lead = Guards.lead

    def led(guards: Guards, seen: Situation) -> np.ndarray:
        assert guards._sight is not None and guards._sight.max_range == 9.0
        reached.append(float(np.linalg.norm(np.nan_to_num(seen.clouds, posinf=0.0), axis=-1).max()))
        return lead(guards, seen)

    def stands(shield: Shield, *_: object) -> np.ndarray:
        shields.add((shield.vehicle.hull, shield.margin))
        return np.zeros(3)

    monkeypatch.setattr(Guards, "lead", led)
    monkeypatch.setattr(Shield, "bend", stands)
    output = tmp_path / "guarded.json"
    command = [
        "policy=straight",
        "valleys=training",
        "guards=all",
        "guards.evasion.sight=9",
        "guards.shield.margin=0.2",
    ]
    command += ["episodes=2", "num_uavs=2", "env.max_steps=3", "progress=false", "env.airframe.collision_radius=0.3"]
    assert in_process(evaluate.main, *command, f"output={output}") == 0
    result = json.loads(output.read_text())
    assert result["outcomes"] == "TT" and max(flight["flown"] for flight in result["flights"]) < 0.2
    assert shields == {((0.3, 0.14), 0.2)}
    assert 4.0 < max(reached) <= 12.0, "as far as the map looks"
    assert set(result["guards"]) == set(ALL) and result["guards"]["evasion"]["sight"] == 9.0


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["guards=typo"], "There is no guard 'typo'; the guards are map, evasion, shield"),
        (["guards=[map,typo]"], "There is no guard 'typo'; the guards are map, evasion, shield"),
        (["guards.shield.margin=far"], "guards.shield.margin must be a number, got 'far'"),
        (["guards.shiel.margin=1"], "There is no guard 'shiel'; the guards are map, evasion, shield: did you mean"),
        (["guards=all", "guards.shield.margin=-1"], "guards.shield.margin must be at least 0, got -1"),
        (["guards=[map]", "guards.shield.margin=1"], "shield is not among the guards asked for"),
    ],
)
def test_a_slip_is_told_in_a_sentence(given: list[str], told: str, refused: Callable[..., str]) -> None:
    assert told in refused(evaluate.main, "policy=straight", *given, "episodes=1")


def test_commands_that_fly_nothing_say_who_takes_them(refused: Callable[..., str]) -> None:
    told = refused(sitl.main, "guards=all")
    assert "has no key 'guards': give it to uavrl-train, uavrl-evaluate, uavrl-replay, uavrl-export or" in told


def test_a_planner_with_a_map_of_its_own_is_not_given_another() -> None:
    pytest.importorskip("ompl")
    with pytest.raises(UavrlError, match=r"policy=rrt_map has a map of its own.* guards=\[evasion,shield\]"):
        chosen("policy=rrt_map", "guards=all")
    assert chosen("policy=rrt_map", "guards=[evasion]").guards.names == ("evasion",)


def test_an_export_names_them_and_flies_with_them(tmp_path: Path) -> None:
    output = tmp_path / "careful"
    asked = ["guards=[shield]", "guards.shield.time=1.5"]
    assert in_process(export.main, "policy=best", *asked, f"output={output}") == 0
    contract = read_contract(output)
    assert contract.guard_settings.names == ("shield",)
    setup = chosen(f"policy={output}")
    assert setup.guards == contract.guard_settings and setup.guards.shield is not None
    assert setup.guards.shield.time == 1.5
    assert chosen(f"policy={output}", "guards=none").guards == GuardSettings()
    assert in_process(export.main, "policy=best", f"output={tmp_path / 'best'}") == 0
    assert read_contract(tmp_path / "best").guard_settings == GuardSettings.all()


def test_a_training_run_has_none_unless_they_are_asked_for(tmp_path: Path) -> None:
    folder = exported(tmp_path, "algo.hidden=[16]")
    assert read_contract(folder).guards is None


def test_the_reward_reads_the_heading_to_the_goal_itself() -> None:
    settings = validate(compose("env.world.obstacles=3"))
    options: dict[str, Any] = {"num_uavs": 1, "seed": 0, "guards": GuardSettings.all()}
    env = make_env(small_env(), settings.perception, settings.reward, **options)
    assert isinstance(env.base_env, NavigationEnv)
    keys = [key for part in env.transform.modules() for key in getattr(part, "in_keys", [])]
    assert keys.count("goal_heading_deg") >= 1 and env.rollout(2)["next", "reward"].shape == (1, 2, 1)
    env.close()


def test_gymnasiums_environment_wraps_the_action() -> None:
    world = {"size": (16.0, 14.0), "obstacles": 12, "min_goal_distance": 5.0, "min_clearance": 1.0}
    ends = []
    for guards in ("none", ["shield"]):
        env = gymnasium.make(
            "uavrl:uavrl/Valley-v0", world=world, guards=guards, max_steps=60, disable_env_checker=True
        )
        collided = 0
        for task in range(3):
            env.reset(seed=0, options={"task": task})
            done = False
            while not done:
                _, _, terminated, truncated, info = env.step(np.array([2.0, 0.0, 0.0, 0.0], np.float32))
                done = terminated or truncated
            collided += bool(info["collided"])
        ends.append(collided)
        env.close()
    assert ends[0] > ends[1] == 0
    with pytest.raises(UavrlError, match="There is no guard 'typo'"):
        gymnasium.make(VALLEY, guards="typo")
    both = gymnasium.make(VALLEY, world=world, guards="all", disable_env_checker=True)
    state, _ = both.reset(seed=0)
    assert state.shape == (105,)
    both.close()
