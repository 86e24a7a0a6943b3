"""The batched navigation environment: TorchRL's contract, tasks, ends of episodes and what it emits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import check_env_specs

from tests.helpers.valleys import SMALL, act, differing, rollout
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.quadrotor import Aerodynamics
from uavrl.envs.randomization import Randomization
from uavrl.envs.world import WorldConfig
from uavrl_onboard.perception.goal import goal_elevation_deg, goal_heading_deg, wrap_degrees


def place(env: NavigationEnv, uav: int, position: list[float] | np.ndarray, yaw: float = 0.0) -> None:
    env.simulation.reset(np.array([uav]), np.asarray(position, dtype=float)[None], np.array([yaw]))


@pytest.mark.parametrize(
    "kwargs",
    [{"measure_clearance": True}, {"world": replace(SMALL, planes=1, plane_wingspan=1.2, plane_keep_out=2.0)}],
    ids=["clearance", "planes"],
)
def test_specs_hold(make: Callable[..., NavigationEnv], kwargs: dict[str, Any]) -> None:
    check_env_specs(make(**kwargs))


def test_a_partial_reset_leaves_the_others_untouched(make: Callable[..., NavigationEnv]) -> None:
    env, undisturbed = make(3), make(3)
    for one in (env, undisturbed):
        state = one.reset()
        for _ in range(2):
            state = one.step(act(state, 1.0, 0.0, 0.0, 1.0))["next"]
    mask = torch.tensor([[False], [True], [False]])
    reset = env.reset(state.clone().set("_reset", mask))
    rest = torch.tensor([0, 2])
    kept = state.exclude("action", "reward")[rest]
    assert not differing(reset.select(*kept.keys())[rest], kept)
    assert reset["task"].flatten().tolist() == [0, 3, 2]
    after = env.step(act(reset, 0.5, 0.0, 0.2, 0.0))["next"]
    expected = undisturbed.step(act(state, 0.5, 0.0, 0.2, 0.0))["next"]
    assert not differing(after[rest], expected[rest])
    assert env._steps.tolist() == [3, 1, 3]


@pytest.mark.parametrize(
    "kwargs",
    [
        {},
        {
            "world": WorldConfig(planes=3),
            "lidar": LidarConfig(4.0, range_noise=0.01, dropout=0.1),
            "aerodynamics": Aerodynamics(gust_intensity=1.0),
        },
    ],
    ids=["static", "planes, noise and gusts"],
)
def test_a_seed_repeats_bit_identically_also_after_other_use(
    make: Callable[..., NavigationEnv], kwargs: dict[str, Any]
) -> None:
    env = make(2, max_steps=4, seed=7, **kwargs)
    first = rollout(env, 6)
    rollout(env, 3, seed=1)
    env.set_seed(7)
    assert not differing(first, rollout(env, 6))
    fresh = make(2, max_steps=4, seed=1, **kwargs)
    assert differing(first, rollout(fresh, 6))
    fresh.set_seed(7)
    assert not differing(first, rollout(fresh, 6))


@pytest.mark.parametrize(
    "kwargs",
    [
        {
            "randomize": Randomization(
                mass=(0.8, 1.2), wind=(0.0, 1.0), gust_intensity=(0.1, 0.5), action_delay=(0.0, 0.02)
            )
        },
        {"world": replace(SMALL, planes=1), "lidar": LidarConfig(max_range=4.0, range_noise=0.01)},
    ],
    ids=["randomised", "planes and noise"],
)
def test_a_physics_in_which_nothing_moved_is_kept_and_flies_as_a_new_one(
    make: Callable[..., NavigationEnv], kwargs: dict[str, Any]
) -> None:
    env, fresh = make(2, max_steps=4, seed=1, **kwargs), make(2, max_steps=4, seed=7, **kwargs)
    env.reset()
    env.simulation.motors_on, kept = False, env.simulation
    env.set_seed(7)
    assert not differing(rollout(env, 9), rollout(fresh, 9))
    assert env.simulation is kept
    env.set_seed(7)
    fresh.set_seed(7)
    assert not differing(rollout(env, 3), rollout(fresh, 3))
    assert env.simulation is not kept


def test_partial_resets_draw_the_new_seeds_tasks_and_a_full_one_rebuilds(make: Callable[..., NavigationEnv]) -> None:
    one_of_two = TensorDict({"_reset": torch.tensor([[True], [False]])}, [2])
    env, fresh = make(2, seed=1), make(2, seed=5)
    with pytest.raises(RuntimeError, match="first reset must be of all UAVs"):
        env.reset(one_of_two.clone())
    env.reset()
    env.set_seed(5)
    expected = fresh.reset()
    assert env.reset(one_of_two.clone())["goal"][0].tolist() == expected["goal"][0].tolist()
    after = env.reset()
    assert not differing(after, expected)


def test_the_number_of_uavs_does_not_change_the_tasks_and_every_reset_draws_new_ones(
    make: Callable[..., NavigationEnv],
) -> None:
    single, triple = make(1), make(3)
    goals = torch.cat([single.reset()["goal"] for _ in range(3)])
    torch.testing.assert_close(goals, triple.reset()["goal"], rtol=0, atol=0)
    assert len(goals.unique(dim=0)) == 3


def test_a_collector_takes_a_seed(make: Callable[..., NavigationEnv]) -> None:
    collector = Collector(partial(make, 2, max_steps=3), None, frames_per_batch=16, total_frames=32)
    try:
        collector.set_seed(0)
        assert sum(batch.numel() for batch in collector) == 32
    finally:
        collector.shutdown()


def test_time_out_is_truncated_not_terminated(make: Callable[..., NavigationEnv]) -> None:
    env = make(1, max_steps=3)
    state, ends = env.reset(), []
    for _ in range(3):
        state = env.step(act(state))["next"]
        ends.append([bool(state[key].item()) for key in ("terminated", "truncated", "done")])
    assert ends == [[False, False, False]] * 2 + [[False, True, True]]


@pytest.mark.parametrize("position", [[0.0, 0.0, 12.0], [21.0, 0.0, 7.0], [0.0, -16.0, 7.0]], ids=["ceiling", "x", "y"])
def test_leaving_the_valley_ends_as_collided(make: Callable[..., NavigationEnv], position: list[float]) -> None:
    env = make(1)
    state = env.reset()
    place(env, 0, position)
    after = env.step(act(state))["next"]
    assert after["collided"].item() and after["terminated"].item() and after["done"].item()
    assert not after["arrived"].item() and not after["truncated"].item()


def test_reaching_the_goals_cylinder_ends_as_arrived(make: Callable[..., NavigationEnv]) -> None:
    env = make(1)
    state = env.reset()
    goal = state["goal"][0].numpy()
    place(env, 0, goal - [1.2, 0.0, 0.0])
    outcomes = []
    while not outcomes or (len(outcomes) < 15 and not outcomes[-1]):
        state = env.step(act(state, 2.0, 0.0, 0.0, 0.0))["next"]
        outcomes.append(bool(state["arrived"].item()))
    assert outcomes[0] is False and outcomes[-1] is True
    assert state["terminated"].item() and state["done"].item()
    assert not state["collided"].item() and not state["truncated"].item()
    assert np.hypot(*(state["position"][0].numpy() - goal)[:2]) <= 1.0


def test_the_environments_own_reward_is_the_progress(make: Callable[..., NavigationEnv]) -> None:
    env = make(2)
    state = env.reset()
    for _ in range(3):
        after = env.step(act(state, 2.0, 0.0, 0.0, 0.0))["next"]
        torch.testing.assert_close(after["reward"], state["distance"] - after["distance"], rtol=0, atol=1e-5)
        state = after


def test_heading_is_counted_left_from_the_head_and_elevation_up_from_the_horizon() -> None:
    q = np.pi / 4
    ahead, left, behind, right = [1, 0, 0], [0, 1, 9], [-1, 0, 0], [0, -1, 0]
    yaws, goals = [0, 0, 0, 0, 2 * q, 2 * q, -4 * q, q], [ahead, left, behind, right, left, ahead, behind, ahead]
    heading = goal_heading_deg(np.zeros((8, 3)), np.array(yaws, float), np.array(goals, float))
    assert ((heading >= 0) & (heading < 360)).all()
    apart = heading - [0, 90, 180, 270, 0, 270, 0, 315]
    np.testing.assert_allclose((apart + 180) % 360 - 180, 0.0, atol=1e-4)
    positions = np.array([[0, 0, 0], [0, 0, 10], [0, 0, 5], [3, 4, 0], [3, 4, 9]], dtype=float)
    elevation = goal_elevation_deg(positions, np.array([[3.0, 4.0, 5.0]]))
    np.testing.assert_allclose(elevation, [45, 315, 0, 90, 270], atol=1e-4)


def test_wrapped_angles_stay_below_360() -> None:
    angles = wrap_degrees(np.array([-1e-12, 2 * np.pi, -2 * np.pi, np.pi]))
    assert angles.dtype == np.float32
    np.testing.assert_allclose(angles, [0.0, 0.0, 0.0, 180.0], atol=1e-4)
    assert (angles < 360).all()


def test_the_emitted_angles_are_those_of_the_flight(make: Callable[..., NavigationEnv]) -> None:
    env = make(1)
    state = env.reset()
    goal = state["goal"][0].numpy().astype(float)
    place(env, 0, goal - [0.0, 3.0, 0.0], yaw=0.0)  # the goal, at the same height, lies to the left
    after = env.step(act(state))["next"]
    assert after["heading_deg"].item() == pytest.approx(90.0, abs=1.0)
    assert abs((after["elevation_deg"].item() + 180) % 360 - 180) < 1.0
    assert after["altitude"].item() == after["position"][0, 2].item() == pytest.approx(goal[2], abs=0.05)
    assert after["distance"].item() == pytest.approx(3.0, abs=0.05)


def test_flights_start_at_rest_at_flight_level(make: Callable[..., NavigationEnv]) -> None:
    state = make(3, world=WorldConfig()).reset()
    torch.testing.assert_close(state["altitude"], torch.full((3, 1), 3.5))
    assert not state["velocity"].any() and not state["arrived"].any() and not state["collided"].any()
    assert (state["distance"] >= 10).all()
    assert len(state["heading_deg"].unique()) == 3


def test_clearance_is_emitted_when_asked_for_down_to_the_ground_where_an_episode_ends_as_collided(
    make: Callable[..., NavigationEnv],
) -> None:
    env = make(1, measure_clearance=True)
    state = env.reset()
    assert 1.0 < state["clearance"].item() <= 5.0
    for _ in range(40):
        after = env.step(act(state, 0.0, 0.0, -2.0, 0.0))["next"]
        if after["collided"].item():
            break
        assert after["clearance"].item() > 0
        state = after
    assert after["collided"].item() and after["terminated"].item() and after["clearance"].item() < 0.1
    assert "clearance" not in make(1).reset()


def test_uavs_do_not_see_each_other(make: Callable[..., NavigationEnv]) -> None:
    env = make(2)
    state = env.reset()
    place(env, 0, state["position"][1].numpy())
    alone, together = env._scan(np.array([1])), env._scan(np.array([0, 1]))
    np.testing.assert_array_equal(alone[1], together[1])
    assert np.isnan(alone[0]).all()
    after = env.step(act(state))["next"]
    assert not after["collided"].any()


@pytest.mark.parametrize(
    "asked",
    [
        lambda env: env.step(TensorDict({"action": torch.zeros(1, 4)}, [1])),
        lambda env: env.simulation,
        lambda env: env.plane_poses(),
        lambda env: env.plane_paths(1),
    ],
)
def test_what_needs_a_reset_says_so(
    make: Callable[..., NavigationEnv], asked: Callable[[NavigationEnv], object]
) -> None:
    with pytest.raises(RuntimeError, match="Reset the environment first"):
        asked(make(1))


def test_a_distorted_scan_ends_where_the_undistorted_one_is_taken() -> None:
    clouds = []
    for distorted in (False, True):
        env = NavigationEnv(1, lidar=LidarConfig(max_range=100.0, motion_distortion=distorted), seed=3)
        state = env.reset()
        for _ in range(12):
            state["action"] = torch.tensor([[2.0, 0.0, 0.0, 1.0]])
            state = env.step(state)["next"]
        clouds.append(state["point_cloud"][0].norm(dim=-1).nan_to_num(0.0).reshape(1808, 16))
    gap = (clouds[0] - clouds[1]).abs()
    first, last = gap[:20].median(), gap[-20:].median()
    assert last < 0.02 < first


def test_goals_and_yaws_of_the_tasks_do_not_depend_on_the_planes_or_the_policy() -> None:
    def tasks(speed: float) -> dict[int, list[float]]:
        env = NavigationEnv(3, world=WorldConfig(planes=3), max_steps=4, seed=11)
        found, state = {}, env.reset()
        for _ in range(25):
            found.update(zip(state["task"][:, 0].tolist(), state["goal"].tolist(), strict=True))
            state["action"] = torch.tensor([[speed, 0.0, 0.0, 0.0]]).expand(3, 4)
            _, state = env.step_and_maybe_reset(state)
        return found

    slow, fast = tasks(0.0), tasks(2.0)
    shared = slow.keys() & fast.keys()
    assert len(shared) >= 15
    assert all(slow[k] == fast[k] for k in shared)


def test_planes_stand_where_the_traffic_is_right_after_a_reset() -> None:
    env = NavigationEnv(1, world=WorldConfig(planes=3), measure_clearance=True, seed=2)
    env.reset()
    position = env.traffic.positions[0]
    env.simulation.reset(np.array([0]), position[None] + [0.0, 0.0, 0.6], np.zeros(1))
    assert env.simulation.closest_distance()[0] < 0.6


def test_the_attitude_is_that_of_the_rotation_with_the_yaw_that_the_vehicle_measures() -> None:
    env = NavigationEnv(3, randomize=Randomization(heading_bias=(0.1, 0.1)), seed=1)
    state = env.reset()
    for _ in range(4):
        state = env.step(act(state, 2.0, 1.0, 0.5, 1.0))["next"]
    roll, pitch, yaw = state["attitude"].double().T.numpy()
    rotation = env.simulation.rotation
    assert np.abs(roll).max() > 0.01 and np.abs(pitch).max() > 0.01
    turned = Rotation.from_euler("ZYX", np.stack([yaw - 0.1, pitch, roll], -1)).as_matrix()
    np.testing.assert_allclose(turned, rotation, atol=1e-6)
