"""The Gymnasium environment: found by its name, accepted by two checkers, repeatable."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

from uavrl.envs.gym import ValleyEnv
from uavrl.envs.register import register_envs
from uavrl.envs.world import WorldConfig

INFO = {"is_success", "collided", "position", "goal", "distance"}
# Actions are the thesis's velocities in m/s and rad/s, not unit numbers; altitude has no bound in the state.
ACCEPTED = ("symmetric and normalized", "minimum value is -infinity", "maximum value is infinity")


@pytest.fixture
def env() -> Iterator[ValleyEnv]:
    env = ValleyEnv(max_steps=4)
    yield env
    env.close()


def fly(env: gymnasium.Env, seed: int | None, steps: int = 4) -> list[np.ndarray]:
    state, info = env.reset(seed=seed)
    rng = np.random.default_rng(3)
    seen = [state, info["position"], info["goal"]]
    for _ in range(steps):
        state, reward, *_, info = env.step(rng.uniform(-2, 2, 4).astype(np.float32))
        seen += [state, np.float64(reward), info["position"]]
    return seen


def identical(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_it_can_show_what_the_best_policy_sees() -> None:
    env = gymnasium.make("uavrl/Valley-v0", max_steps=3, reduction="range_image", last_action=True)
    first = env.reset(seed=0)[0]
    action = np.array([1.5, -0.5, 0.0, 1.0], dtype=np.float32)
    state = env.step(action)[0]
    env.close()
    assert first.shape == env.observation_space.shape == (3 * 79,)
    np.testing.assert_allclose(state[-4:], action / 2)
    with pytest.raises(ValueError, match="reduction must be one of truncated_icosahedron, range_image"):
        gymnasium.make("uavrl/Valley-v0", reduction="cube")


def test_registering_twice_does_no_harm() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        register_envs()


def test_gymnasiums_checker_passes() -> None:
    env = gymnasium.make("uavrl/Valley-v0", max_steps=4)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()
    messages = [str(warning.message) for warning in caught]
    assert not [m for m in messages if not any(accepted in m for accepted in ACCEPTED)]


def test_stable_baselines3s_checker_passes(env: ValleyEnv) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env_for_sb3(env, skip_render_check=True)
    messages = [str(warning.message) for warning in caught]
    assert not [m for m in messages if not any(accepted in m for accepted in ACCEPTED)]


def test_states_are_105_floats_oldest_frame_first(env: ValleyEnv) -> None:
    state, _ = env.reset(seed=0)
    assert state.shape == (105,) and state.dtype == np.float32 and env.observation_space.contains(state)
    assert not state[:70].any() and state[70:].any()
    after, *_ = env.step(np.zeros(4, dtype=np.float32))
    assert not after[:35].any()
    np.testing.assert_array_equal(after[35:70], state[70:])


def test_one_frame_gives_35_numbers() -> None:
    env = ValleyEnv(frames=1)
    assert env.reset(seed=0)[0].shape == env.observation_space.shape == (35,)
    env.close()


def test_actions_are_bounded_by_two(env: ValleyEnv) -> None:
    np.testing.assert_array_equal(env.action_space.low, np.full(4, -2.0))
    np.testing.assert_array_equal(env.action_space.high, np.full(4, 2.0))


def test_a_seed_repeats_bit_identically_also_after_other_use(env: ValleyEnv) -> None:
    first = fly(env, 5)
    fly(env, None)
    assert identical(first, fly(env, 5))
    other = ValleyEnv(max_steps=4)
    assert identical(first, fly(other, 5))
    assert not identical(first, fly(other, 6))
    other.close()


def test_a_reset_without_a_seed_goes_on_to_the_next_task(env: ValleyEnv) -> None:
    _, first = env.reset(seed=0)
    _, second = env.reset()
    assert not np.array_equal(first["goal"], second["goal"])
    env.reset(seed=0)
    np.testing.assert_array_equal(env.reset()[1]["goal"], second["goal"])


def test_time_out_is_truncation(env: ValleyEnv) -> None:
    env.reset(seed=0)
    ends = [env.step(np.zeros(4, dtype=np.float32))[2:4] for _ in range(4)]
    assert ends == [(False, False)] * 3 + [(False, True)]


def test_info_says_how_it_stands(env: ValleyEnv) -> None:
    _, at_reset = env.reset(seed=0)
    *_, info = env.step(np.zeros(4, dtype=np.float32))
    for said in (at_reset, info):
        assert set(said) == INFO
        assert said["is_success"] is False and said["collided"] is False
        assert said["position"].shape == said["goal"].shape == (3,)
        assert said["distance"] == pytest.approx(np.linalg.norm(said["goal"] - said["position"]), abs=1e-4)


def test_earlier_states_and_infos_stay_as_they_were(env: ValleyEnv) -> None:
    state, info = env.reset(seed=0)
    kept, position = state.copy(), info["position"].copy()
    env.step(np.full(4, 2.0, dtype=np.float32))
    np.testing.assert_array_equal(state, kept)
    np.testing.assert_array_equal(info["position"], position)


def test_the_reward_is_chosen_by_name() -> None:
    rewards = {}
    for name in ("navigation", "traditional"):
        env = ValleyEnv(name)
        _, before = env.reset(seed=0)
        _, rewards[name], *_, after = env.step(np.array([2, 0, 0, 0], dtype=np.float32))
        progress = before["distance"] - after["distance"]
        env.close()
    assert rewards["traditional"] == pytest.approx(progress, abs=1e-5)
    assert abs(rewards["navigation"] - rewards["traditional"]) > 1e-3


def test_a_world_of_ones_own_is_flown_in() -> None:
    env = ValleyEnv(world=WorldConfig(seeds=(3,), size=(30.0, 20.0), obstacles=5, planes=1))
    state, info = env.reset(seed=0)
    assert state.shape == (105,) and (np.abs(info["position"][:2]) < [15.0, 10.0]).all()
    env.close()


def test_closing_twice_does_no_harm() -> None:
    env = ValleyEnv()
    env.reset(seed=0)
    env.close()
    env.close()


def test_closing_before_the_first_reset_does_no_harm() -> None:
    ValleyEnv().close()


def test_an_unknown_reward_is_refused() -> None:
    with pytest.raises(ValueError, match="reward must be one of navigation, traditional, got 'sparse'"):
        ValleyEnv("sparse")  # type: ignore[arg-type]
