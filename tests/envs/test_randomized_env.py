"""The navigation environment whose vehicles differ from episode to episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torchrl.envs import check_env_specs

from tests.helpers.valleys import SMALL, act, differing, rollout
from uavrl.config import compose, validate
from uavrl.envs import NavigationEnv, Randomization, VehicleParams
from uavrl.envs.randomization import LIMITS
from uavrl.evaluation.environment import make_env

REAL = validate(compose("randomize=real")).env.randomize
PLANES = replace(SMALL, planes=1, plane_wingspan=1.2, plane_keep_out=2.0)


def test_specs_hold(make: Callable[..., NavigationEnv]) -> None:
    check_env_specs(make(randomize=REAL, world=PLANES))


def test_vehicles_that_are_drawn_as_believed_fly_bit_by_bit_as_none_that_are_drawn(
    make: Callable[..., NavigationEnv],
) -> None:
    factors = dict.fromkeys(("mass", "inertia", "thrust", "motor_time_constant", "drag"), (1.0, 1.0))
    rest = set(LIMITS) - set(factors) - {"gust_intensity", "range_noise", "dropout"}  # which replace the constant ones
    neutral = make(randomize=Randomization(**factors, **dict.fromkeys(rest, (0.0, 0.0))))
    none, off = make(), make(randomize=Randomization())
    assert neutral.randomize is not None and off.randomize is None
    assert not differing(rollout(none, 8), rollout(neutral, 8))
    assert [replace(plant, mount_axis=0.0, blind_azimuth=0.0) for plant in neutral.vehicle_params] == [
        VehicleParams(),
        VehicleParams(),
    ]


def test_the_vehicles_of_a_task_are_the_same_in_any_company_and_under_any_policy(
    make: Callable[..., NavigationEnv],
) -> None:
    def drawn(env: NavigationEnv, *action: float) -> dict[int, tuple[Any, ...]]:
        found, state = {}, env.reset()
        while len(found) < 4:
            for row in range(env.num_uavs):
                begun = env._goal[row], env.vehicle_params[row]
                found.setdefault(int(state["task"][row]), (begun[0].copy(), begun[1]))
            state = env.step_and_maybe_reset(act(state, *action))[1]
        return found

    one = drawn(make(1, randomize=REAL, max_steps=3), 0, 0, 0, 0)
    three = drawn(make(3, randomize=REAL, max_steps=4), 1, 1, 0, 1)
    plain = drawn(make(2, max_steps=4), 0, 0, 0, 0)
    for task in range(4):
        assert one[task][1] == three[task][1] != VehicleParams()
        np.testing.assert_array_equal(one[task][0], three[task][0])
        np.testing.assert_array_equal(one[task][0], plain[task][0])
    assert len({plant for _, plant in one.values()}) == len(one)


def test_starts_and_goals_are_those_of_vehicles_that_are_as_believed(make: Callable[..., NavigationEnv]) -> None:
    real, plain = make(3, randomize=REAL).reset(task=5), make(3).reset(task=5)
    assert set(differing(real, plain)) == {"point_cloud", "altitude", "heading_deg", "attitude"}


def test_another_seed_has_other_vehicles_and_the_same_one_the_same_flights(make: Callable[..., NavigationEnv]) -> None:
    """What a resumed run relies on: it goes on with a seed of its own."""
    env = make(2, randomize=REAL, world=PLANES, max_steps=3, seed=1)
    env.reset()
    first = env.vehicle_params
    rollout(env, 4)
    env.set_seed(7)
    went_on = rollout(env, 8)
    assert first != env.vehicle_params
    anew = make(2, randomize=REAL, world=PLANES, max_steps=3, seed=7)
    assert not differing(went_on, rollout(anew, 8))


def test_a_partial_reset_changes_only_its_own_vehicle(make: Callable[..., NavigationEnv]) -> None:
    quiet = replace(REAL, gust_intensity=None, range_noise=None, dropout=None)
    env, undisturbed = make(2, randomize=quiet), make(2, randomize=quiet)
    state, other = env.reset(), undisturbed.reset()
    for step in range(8):
        state, other = (e.step(act(s, 0.5, 0, 0, 1))["next"] for e, s in ((env, state), (undisturbed, other)))
        if step == 3:
            before = env.vehicle_params
            state = env.reset(state.set("_reset", torch.tensor([[True], [False]])))
            assert env.vehicle_params[0] != before[0] and env.vehicle_params[1] == before[1]
        assert not differing(state[1].exclude("_reset"), other[1])


def test_biases_reach_what_the_policy_reads_and_nothing_else(make: Callable[..., NavigationEnv]) -> None:
    biased = make(randomize=Randomization(altitude_bias=(0.2, 0.2), heading_bias=(0.1, 0.1)))
    for seen, true in zip(*(rollout(env, 6)["next"].unbind(1) for env in (biased, make())), strict=True):
        assert set(differing(seen, true)) == {"altitude", "heading_deg", "attitude"}
        turned = seen["attitude"] - true["attitude"]
        torch.testing.assert_close(turned, torch.tensor([0.0, 0.0, 0.1]).expand_as(turned), atol=1e-5, rtol=0)
        torch.testing.assert_close(seen["altitude"], true["altitude"] + 0.2)
        off = (true["heading_deg"] - seen["heading_deg"] + 180) % 360 - 180
        torch.testing.assert_close(off, torch.full_like(off, np.degrees(0.1)), atol=1e-3, rtol=0)


def test_a_blind_environment_and_one_of_a_whole_configuration_take_it(make: Callable[..., NavigationEnv]) -> None:
    assert torch.isnan(make(randomize=REAL, blind=True).reset()["point_cloud"]).all()
    small = ["env.world.size=[14.0,12.0]", "env.world.obstacles=3", "env.world.min_goal_distance=4.0"]
    config = validate(compose("randomize=vehicle", "env.randomize.mass=null", *small))
    env = make_env(config.env, config.perception, config.reward, seed=0, num_uavs=2)
    env.reset()
    plant = env.base_env.vehicle_params[0]
    env.close()
    assert plant.mass == 1.0 != plant.thrust and plant.action_delay == 0.0
