from __future__ import annotations

import sys

import pytest
import torch
from torchrl.envs import check_env_specs

from uavrl.envs.bipedal import ACTION_LIMIT, ACTIONS, OBSERVATIONS, BipedalEnv
from uavrl.errors import UavrlError


def walk(env: BipedalEnv, steps: int = 150) -> torch.Tensor:
    """Observations of two episodes under the same torques."""
    torch.manual_seed(0)
    return torch.cat([env.rollout(steps)["next", "observation"] for _ in range(2)])


def test_it_matches_its_specs_and_the_sizes_that_networks_are_built_for() -> None:
    env = BipedalEnv()
    check_env_specs(env)
    assert env.observation_spec["observation"].shape == (OBSERVATIONS,)
    assert env.action_spec.shape == (ACTIONS,)
    assert env.action_spec.space.high.unique().tolist() == [ACTION_LIMIT]


def test_a_course_depends_on_seed_and_number_alone() -> None:
    env = BipedalEnv(seed=3)
    first = walk(env)
    env.set_seed(3)  # in a process that has walked
    assert torch.equal(walk(env), first)
    assert torch.equal(walk(BipedalEnv(seed=3)), first)
    assert not torch.equal(walk(BipedalEnv(seed=4))[:40], first[:40])


def test_a_fall_ends_an_episode_for_good() -> None:
    env = BipedalEnv(seed=0)
    state = env.reset()
    assert not state["collided"] and not state["arrived"] and state["task"].item() == 0
    while not state["done"]:
        state = env.step(state.set("action", torch.zeros(4)))["next"]  # it sinks into its knees
    assert state["collided"] and state["terminated"] and not state["arrived"] and not state["truncated"]
    assert state["reward"].item() == -100.0
    assert env.reset()["task"].item() == 1


def test_the_end_of_the_course_is_an_arrival() -> None:
    env = BipedalEnv()
    state = env.reset()
    hull = env._env.unwrapped.hull
    for body in (hull, *env._env.unwrapped.legs):
        body.position = (body.position[0] + 87.0, body.position[1] + 3.0)
    state = env.step(state.set("action", torch.zeros(4)))["next"]
    assert state["arrived"] and state["terminated"] and not state["collided"]


def test_the_limit_of_steps_truncates() -> None:
    last = BipedalEnv(max_steps=5).rollout(9)[-1]["next"]
    assert last["truncated"] and last["done"]
    assert not last["terminated"] and not last["arrived"] and not last["collided"]


def test_without_box2d_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "Box2D", None)
    for name in [name for name in sys.modules if name.startswith("gymnasium.envs.box2d")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(UavrlError, match=r"needs Box2D.*uavrl\[bipedal\]"):
        BipedalEnv()
