"""What Gymnasium's users ask of the valley: pictures, and tasks by their numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import AddRenderObservation

from uavrl.envs.gym import ValleyEnv
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError

NAME = "uavrl:uavrl/Valley-v0"
SMALL = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=5.0, planes=1, plane_keep_out=2.0)


@pytest.fixture(scope="module")
def env() -> Iterator[gymnasium.Env]:
    env = gymnasium.make(NAME, world=SMALL, render_mode="rgb_array")
    yield env
    env.close()


def test_it_draws_what_lies_ahead(env: gymnasium.Env) -> None:
    assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": 10}
    env.reset(seed=0)
    first = env.render()
    assert isinstance(first, np.ndarray) and first.shape == (360, 480, 3) and first.dtype == np.uint8
    blue = (first[..., 2] > 100) & (first[..., 0] < 60)
    assert 500 < blue.sum() < 20_000, "the UAV"
    assert abs(np.nonzero(blue)[1].mean() - 240) < 10, "in the middle"
    for _ in range(3):
        env.step(np.array([2.0, 0.0, 0.0, 1.0], dtype=np.float32))
    assert (env.render() != first).mean() > 0.05


def test_wrappers_that_need_pictures_take_it(env: gymnasium.Env) -> None:
    assert AddRenderObservation(env).reset(seed=0)[0].shape == (360, 480, 3)


def test_without_a_render_mode_there_is_no_picture() -> None:
    assert ValleyEnv(world=SMALL).render() is None


@pytest.mark.parametrize("mode", ["human", "ansi", "rgb_array_list"])
def test_another_render_mode_is_refused_in_a_sentence(mode: str) -> None:
    with pytest.raises(UavrlError, match=f"render_mode must be rgb_array or None, got '{mode}': .* uavrl-replay"):
        gymnasium.make(NAME, world=SMALL, render_mode=mode)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_gymnasiums_checker_accepts_it_with_pictures(env: gymnasium.Env) -> None:
    check_env(env.unwrapped, skip_render_check=True)


def test_a_reset_takes_a_tasks_number(env: gymnasium.Env) -> None:
    info = [env.reset(seed=4)[1] for _ in range(1)] + [env.reset()[1] for _ in range(3)]
    for options in ({"task": 3}, {"task": np.int64(3)}):
        _, again = env.reset(seed=4, options=options)
        np.testing.assert_array_equal(again["goal"], info[3]["goal"])
    _, after = env.reset(options={})
    assert (after["goal"] != info[3]["goal"]).any(), "task 4"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"tsk": 5}, "options takes task, the number of a task, got 'tsk'"),
        ({"task": -1}, r"options\['task'\] must be a whole number, 0 or more, got -1"),
        ({"task": 1.5}, r"options\['task'\] must be a whole number, 0 or more, got 1.5"),
    ],
)
def test_other_options_are_refused(env: gymnasium.Env, options: dict[str, Any], said: str) -> None:
    with pytest.raises(UavrlError, match=said):
        env.reset(options=options)
