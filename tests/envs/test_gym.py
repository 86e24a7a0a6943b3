"""The Gymnasium environment: found by its name, accepted by two checkers, repeatable, with pictures and tasks."""

from __future__ import annotations

import copy
import pickle
import warnings
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import AddRenderObservation, RecordVideo, RenderCollection
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

from uavrl.envs.gym import ValleyEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.quadrotor import Airframe
from uavrl.envs.randomization import Randomization
from uavrl.envs.register import register_with_gymnasium
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError

NAME = "uavrl:uavrl/Valley-v0"
SMALL = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=5.0, planes=1, plane_keep_out=2.0)
HOVER = np.zeros(4, dtype=np.float32)
# Actions are the thesis's velocities in m/s and rad/s, not unit numbers; altitude has no bound in the state.
ACCEPTED = ("symmetric and normalized", "minimum value is -infinity", "maximum value is infinity")


@pytest.fixture
def env() -> Iterator[ValleyEnv]:
    env = ValleyEnv(world=SMALL, max_steps=4)
    yield env
    env.close()


@pytest.fixture(scope="module")
def drawn() -> Iterator[gymnasium.Env]:
    env = gymnasium.make(NAME, world=SMALL, render_mode="rgb_array")
    yield env
    env.close()


def roll_out(env: gymnasium.Env, seed: int | None, steps: int = 4) -> list[np.ndarray]:
    state, info = env.reset(seed=seed)
    rng = np.random.default_rng(3)
    seen = [state, info["position"], info["goal"]]
    for _ in range(steps):
        state, reward, *_, info = env.step(rng.uniform(-2, 2, 4).astype(np.float32))
        seen += [state, np.float64(reward), info["position"]]
    return seen


def identical(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("check", [check_env, check_env_for_sb3])
def test_the_checkers_pass(check: Callable[..., None], drawn: gymnasium.Env) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check(drawn.unwrapped, skip_render_check=True)
        register_with_gymnasium()  # a second time
    messages = [str(warning.message) for warning in caught]
    assert not [m for m in messages if not any(accepted in m for accepted in ACCEPTED)]


def test_it_can_show_what_the_best_policy_sees() -> None:
    env = gymnasium.make(NAME, world=SMALL, reduction="range_image", last_action=True)
    first, action = env.reset(seed=0)[0], np.array([1.5, -0.5, 0.0, 1.0], dtype=np.float32)
    state = env.step(action)[0]
    env.close()
    assert first.shape == env.observation_space.shape == (3 * 79,)
    np.testing.assert_allclose(state[-4:], action / 2)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"reward": "sparse"}, "reward must be one of navigation, traditional, got 'sparse'"),
        ({"reduction": "cube"}, "reduction must be one of truncated_icosahedron, range_image"),
        *(
            ({"render_mode": mode}, f"render_mode must be rgb_array or None, got '{mode}': .* uavrl-replay")
            for mode in ("human", "ansi", "rgb_array_list")
        ),
    ],
)
def test_what_it_does_not_know_is_refused_in_a_sentence(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        gymnasium.make(NAME, world=SMALL, **settings)


@pytest.mark.parametrize("action", [[1.0, 2.0, 3.0], [[0.0] * 4] * 2, 0.0])
def test_an_action_of_another_shape_is_refused(env: ValleyEnv, action: object) -> None:
    env.reset(seed=0)
    with pytest.raises(UavrlError, match="An action is 4 numbers"):
        env.step(action)


def test_states_are_105_floats_oldest_frame_first_and_earlier_ones_stay_as_they_were(env: ValleyEnv) -> None:
    state, info = env.reset(seed=0)
    assert state.shape == (105,) and state.dtype == np.float32 and env.observation_space.contains(state)
    assert not state[:70].any() and state[70:].any()
    kept, position = state.copy(), info["position"].copy()
    after, *_ = env.step(np.full(4, 2.0, dtype=np.float32))
    assert not after[:35].any()
    np.testing.assert_array_equal(after[35:70], state[70:])
    np.testing.assert_array_equal(state, kept)
    np.testing.assert_array_equal(info["position"], position)
    one = ValleyEnv(world=SMALL, frames=1)
    assert one.reset(seed=0)[0].shape == one.observation_space.shape == (35,)
    one.close()


def test_a_seed_repeats_bit_identically_also_after_other_use(env: ValleyEnv) -> None:
    first = roll_out(env, 5)
    roll_out(env, None)
    assert identical(first, roll_out(env, 5))
    other = ValleyEnv(world=SMALL, max_steps=4)
    assert identical(first, roll_out(other, 5)) and not identical(first, roll_out(other, 6))
    other.close()


def test_time_out_is_truncation_and_info_says_how_it_stands(env: ValleyEnv) -> None:
    infos, ends = [env.reset(seed=0)[1]], []
    for _ in range(4):
        _, _, *end, info = env.step(HOVER)
        infos, ends = [*infos, info], [*ends, end]
    assert ends == [[False, False]] * 3 + [[False, True]]
    for info in infos:
        assert set(info) == {"is_success", "collided", "position", "goal", "distance"}
        assert info["is_success"] is False and info["collided"] is False
        assert info["distance"] == pytest.approx(np.linalg.norm(info["goal"] - info["position"]), abs=1e-4)


def test_the_reward_is_chosen_by_name() -> None:
    rewards = {}
    for name in ("navigation", "traditional"):
        env = ValleyEnv(name, world=SMALL)
        _, before = env.reset(seed=0)
        _, rewards[name], *_, after = env.step(np.array([2, 0, 0, 0], dtype=np.float32))
        progress = before["distance"] - after["distance"]
        env.close()
    assert rewards["traditional"] == pytest.approx(progress, abs=1e-5)
    assert abs(rewards["navigation"] - rewards["traditional"]) > 1e-3


def test_closing_twice_or_before_the_first_reset_does_no_harm(env: ValleyEnv) -> None:
    for _ in range(2):
        env.close()


def test_it_draws_what_lies_ahead(drawn: gymnasium.Env) -> None:
    assert drawn.metadata == {"render_modes": ["rgb_array"], "render_fps": 10}
    drawn.reset(seed=0)
    first = drawn.render()
    assert isinstance(first, np.ndarray) and first.shape == (360, 480, 3) and first.dtype == np.uint8
    blue = (first[..., 2] > 100) & (first[..., 0] < 60)
    assert 500 < blue.sum() < 20_000, "the UAV"
    assert abs(np.nonzero(blue)[1].mean() - 240) < 10, "in the middle"
    for _ in range(3):
        drawn.step(np.array([2.0, 0.0, 0.0, 1.0], dtype=np.float32))
    assert (drawn.render() != first).mean() > 0.05
    assert AddRenderObservation(drawn).reset(seed=0)[0].shape == (360, 480, 3), "wrappers that need pictures"


def test_its_pictures_make_a_film(drawn: gymnasium.Env) -> None:
    film = RenderCollection(drawn)
    film.reset(seed=0)
    for _ in range(3):
        film.step(np.array([2.0, 0.0, 0.0, 1.0], dtype=np.float32))
    frames = film.render()
    assert frames is not None and [frame.shape for frame in frames] == [(360, 480, 3)] * 4
    assert all((one != other).any() for one, other in pairwise(frames)), "each shows another moment"


def test_record_video_writes_one(drawn: gymnasium.Env, tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="RecordVideo writes by MoviePy: pip install moviepy")
    video = RecordVideo(drawn, str(tmp_path), episode_trigger=lambda episode: True)
    video.reset(seed=0)
    video.step(HOVER)
    video.stop_recording()
    assert [file.suffix for file in tmp_path.iterdir()] == [".mp4"]


def test_without_a_render_mode_there_is_no_picture(env: ValleyEnv) -> None:
    assert env.render() is None


def test_a_reset_takes_a_tasks_number(drawn: gymnasium.Env) -> None:
    info = [drawn.reset(seed=4)[1]] + [drawn.reset()[1] for _ in range(3)]
    for options in ({"task": 3}, {"task": np.int64(3)}):
        _, again = drawn.reset(seed=4, options=options)
        np.testing.assert_array_equal(again["goal"], info[3]["goal"])
    _, after = drawn.reset(options={})
    assert (after["goal"] != info[3]["goal"]).any(), "task 4"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"tsk": 5}, "options takes task, the number of a task, got 'tsk'"),
        ({"task": -1}, r"options\['task'\] must be a whole number, 0 or more, got -1"),
        ({"task": 1.5}, r"options\['task'\] must be a whole number, 0 or more, got 1.5"),
    ],
)
def test_other_options_are_refused(drawn: gymnasium.Env, options: dict[str, Any], said: str) -> None:
    with pytest.raises(UavrlError, match=said):
        drawn.reset(options=options)


SETTINGS: dict[str, Any] = {
    "world": SMALL,
    "lidar": LidarConfig(max_range=5.0),
    "airframe": Airframe(mass=1.6),
    "randomize": Randomization(mass=(0.9, 1.1)),
}


@pytest.mark.parametrize(
    "kept",
    [
        lambda spec: EnvSpec.from_json(spec.to_json()),
        lambda spec: pickle.loads(pickle.dumps(spec)),
        copy.deepcopy,
    ],
    ids=["json", "pickle", "deepcopy"],
)
def test_a_specification_makes_the_same_environment_wherever_it_was_kept(kept: Callable[[EnvSpec], EnvSpec]) -> None:
    env = gymnasium.make(NAME, max_episode_steps=7, **SETTINGS)
    assert env.spec is not None
    again = gymnasium.make(kept(env.spec))
    assert again.spec is not None and again.spec.max_episode_steps == 7
    one, other = (each.unwrapped._base for each in (env, again))  # type: ignore[attr-defined]
    assert other.world_config == one.world_config == SMALL
    assert (other.lidar_config, other.airframe, other.randomize) == tuple(SETTINGS.values())[1:]
    assert identical(roll_out(env, 1), roll_out(again, 1))
    env.close()
    again.close()
