"""The environment for Stable-Baselines3: what its own vector of single environments gives, and what shares a world."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import TD3
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecMonitor, VecNormalize

from tests.envs.test_gym_vector import ACTIONS, LIMIT, VEHICLES, InTurn, require_alike
from tests.helpers.valleys import SMALL
from uavrl.envs.sb3 import ValleyVecEnv
from uavrl.errors import UavrlError


@pytest.fixture
def env() -> Iterator[ValleyVecEnv]:
    env = ValleyVecEnv(VEHICLES, world=SMALL, max_steps=LIMIT)
    yield env
    env.close()


def test_it_gives_what_their_vector_of_single_environments_gives(env: ValleyVecEnv) -> None:
    tasks = iter(range(100))
    theirs = DummyVecEnv([lambda: InTurn(tasks)] * VEHICLES)
    assert (env.observation_space, env.action_space) == (theirs.observation_space, theirs.action_space)
    assert env.seed(3) == [3] * VEHICLES
    require_alike(env.reset(), theirs.reset())
    for actions in ACTIONS:
        (*numbers, infos), (*their_numbers, their_infos) = env.step(actions), theirs.step(actions)
        require_alike(numbers, their_numbers)
        for info, other in zip(infos, their_infos, strict=True):
            assert {key: type(value) for key, value in info.items()} == {key: type(other[key]) for key in other}
            for key, value in info.items():
                np.testing.assert_allclose(value, other[key], atol=1e-3, err_msg=key)
        for info, other in zip(env.reset_infos, theirs.reset_infos, strict=True):
            np.testing.assert_allclose(info["goal"], other["goal"], atol=1e-5)
    assert next(tasks) > 2 * VEHICLES, "episodes have ended"
    theirs.close()


def test_running_out_of_time_is_told_from_an_end(env: ValleyVecEnv) -> None:
    env.seed(0)
    env.reset()
    told = [env.step(np.zeros((VEHICLES, 4)))[2:] for _ in range(LIMIT)]
    assert [dones.tolist() for dones, _ in told] == [[False] * VEHICLES] * (LIMIT - 1) + [[True] * VEHICLES]
    assert [info["TimeLimit.truncated"] for info in told[-1][1]] == [True] * VEHICLES
    assert not any("terminal_observation" in info for _, infos in told[:-1] for info in infos)
    falling = ValleyVecEnv(1, world=SMALL)
    falling.reset()
    for _ in range(60):
        _, _, dones, infos = falling.step(np.array([[0.0, 0.0, -2.0, 0.0]]))
        if dones[0]:
            break
    assert dones[0] and infos[0]["collided"] and not infos[0]["TimeLimit.truncated"]
    falling.close()


def test_seeds_and_options_count_for_one_reset(env: ValleyVecEnv) -> None:
    def goals() -> np.ndarray:
        env.reset()
        return np.stack([info["goal"] for info in env.reset_infos])

    env.seed(4)
    first, later = goals(), goals()
    assert (first != later).any()
    env.seed(4)
    np.testing.assert_array_equal(goals(), first)
    env.set_options({"task": VEHICLES})
    np.testing.assert_array_equal(goals(), later)
    env.set_options([{"task": 0}] * VEHICLES)
    np.testing.assert_array_equal(goals(), first)
    with pytest.raises(UavrlError, match="same options for all"):
        env.set_options([{"task": 0}, {"task": 5}, {"task": 0}])


def test_attributes_and_methods_are_those_of_the_world(env: ValleyVecEnv) -> None:
    assert env.get_attr("render_mode") == [None] * VEHICLES and env.get_attr("num_envs", 0) == [VEHICLES]
    assert env.get_attr("observation_space", [0, 1]) == [env.observation_space] * 2
    assert env.has_attr("metadata") and not env.has_attr("colour")
    env.set_attr("colour", "red")
    assert env.get_attr("colour", indices=2) == ["red"]
    assert env.env_method("__repr__", indices=0) == ["ValleyVectorEnv(num_envs=3)"]
    assert env.env_is_wrapped(Monitor) == [False] * VEHICLES and env.env_is_wrapped(Monitor, 1) == [False]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda env: env.set_attr("colour", "red", indices=[0]), "set colour for all of them, without indices"),
        *(
            (lambda env, name=name: env.env_method(name), f"call {name}\\(\\) of the whole")
            for name in ("reset", "step")
        ),
    ],
)
def test_what_would_touch_other_vehicles_is_refused(
    env: ValleyVecEnv, call: Callable[[ValleyVecEnv], Any], said: str
) -> None:
    with pytest.raises(UavrlError, match=said):
        call(env)


def test_it_draws_all_vehicles_in_one_picture() -> None:
    env = ValleyVecEnv(2, world=SMALL, render_mode="rgb_array")
    env.reset()
    picture = env.render()
    assert picture is not None and picture.shape == (2 * 360, 480, 3)
    assert env.env_method("render", indices=1)[0].shape == (360, 480, 3)
    env.close()
    blind = ValleyVecEnv(1, world=SMALL)
    blind.reset()
    with pytest.warns(UserWarning, match="no pictures without render_mode"):
        assert blind.get_images() == [None]
    blind.close()


def test_their_wrappers_training_and_evaluation_take_it(env: ValleyVecEnv) -> None:
    wrapped = VecMonitor(VecNormalize(VecCheckNan(env, raise_exception=True)))
    model = TD3("MlpPolicy", wrapped, learning_starts=6, batch_size=4, policy_kwargs={"net_arch": [8]}, seed=0)
    model.learn(5 * VEHICLES * LIMIT)
    assert model.num_timesteps == 5 * VEHICLES * LIMIT and len(model.ep_info_buffer or ()) == 5 * VEHICLES
    returns, lengths = evaluate_policy(model, VecMonitor(env), n_eval_episodes=3, return_episode_rewards=True)
    assert len(returns) == 3 and max(lengths) <= LIMIT


def test_without_stable_baselines3_a_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "uavrl.envs.sb3")
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    with pytest.raises(
        UavrlError, match="needs Stable-Baselines3, which is not installed: pip install stable-baselines3"
    ):
        importlib.import_module("uavrl.envs.sb3")
