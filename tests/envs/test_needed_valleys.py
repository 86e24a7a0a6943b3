"""Who names the tasks builds only their valleys, and flies as among all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.helpers.commands import in_process
from uavrl.cli import replay as command
from uavrl.envs import world as world_module
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.traffic import Traffic
from uavrl.envs.world import World, WorldConfig
from uavrl.errors import UavrlError

SEVERAL = WorldConfig(seeds=(3, 4, 5, 6), size=(14.0, 12.0), obstacles=(3, 2, 4), min_goal_distance=5.0)
AMONG_PLANES = replace(SEVERAL, seeds=(3, 4), planes=1, plane_keep_out=2.0, plane_wingspan=1.2)


def test_a_valley_is_the_same_whatever_is_built_beside_it() -> None:
    whole, few = World(AMONG_PLANES), World(AMONG_PLANES, needed=[1])
    assert (few.built, [valley.seed for valley in few.places]) == ([1], [4])
    np.testing.assert_array_equal(few.places[0].origin, whole.places[1].origin)
    assert len(few.places[0].obstacles) == len(whole.places[1].obstacles) == 2
    planes, some = (Traffic(world, np.random.default_rng(0)) for world in (whole, few))
    np.testing.assert_array_equal(some.positions, planes.positions[[1]])
    np.testing.assert_array_equal(some.advance(240, 1 / 240), planes.advance(240, 1 / 240)[:, [1]])


def flown(env: NavigationEnv, task: int) -> TensorDict:
    env.set_seed(2)
    state, steps = env.reset(task=task), []
    for _ in range(6):
        state["action"] = torch.tensor([[2.0, 0.5, -0.3, 0.4]])
        state = env.step(state)["next"]
        steps.append(state.clone())
    return torch.stack(steps)


def test_flights_are_the_same_to_the_last_bit() -> None:
    told = {"lidar": LidarConfig(max_range=4.0), "measure_clearance": True, "seed": 2}
    whole, few = (NavigationEnv(1, world=SEVERAL, tasks=tasks, **told) for tasks in (None, (1, 0)))
    for task in (0, 1):
        for key, value in flown(whole, task).items():
            assert torch.equal(flown(few, task)[key].nan_to_num(9.0), value.nan_to_num(9.0)), (task, key)
    assert len(few.world.places) < 3
    whole.close()
    few.close()


def test_another_seed_needs_other_valleys_and_other_tasks_are_refused() -> None:
    env = NavigationEnv(1, world=SEVERAL, tasks=[0], lidar=LidarConfig(max_range=4.0))
    seen = set()
    for seed in range(6):
        env.set_seed(seed)
        seen.add(env.reset()["world_seed"].item())
        assert [valley.seed for valley in env.world.places] == [env._world_seed[0]]
    assert len(seen) > 1
    with pytest.raises(UavrlError, match=r"the valley of seed [3-6], which was not built: name the task"):
        for task in range(1, 9):
            env.reset(task=task)
    env.close()


def test_tasks_are_flown_in_the_order_in_which_they_are_named() -> None:
    told = {"lidar": LidarConfig(max_range=4.0), "seed": 2}
    named = NavigationEnv(2, world=SEVERAL, tasks=[6, 1, 4], randomize={"mass": (0.8, 1.2)}, **told)
    every = NavigationEnv(1, world=SEVERAL, randomize={"mass": (0.8, 1.2)}, **told)
    first, one_of_two = named.reset(), TensorDict({"_reset": torch.tensor([[True], [False]])}, [2])
    flown = [(first[i], named.vehicle_params[i].mass) for i in (0, 1)]
    flown += [(named.reset(one_of_two.clone())[0], named.vehicle_params[0].mass)]
    assert [own["task"].item() for own, _ in flown] == [6, 1, 4]
    further = named.reset(one_of_two.clone())[0]["task"].item()
    assert (further, named.tasks_begun) == (7, 8), "behind the last of them"
    for task, (own, mass) in zip((6, 1, 4), flown, strict=True):
        alone = every.reset(task=task)[0]
        for key in ("position", "goal", "world_seed", "attitude"):
            assert torch.equal(own[key], alone[key]), (task, key)
        assert mass == every.vehicle_params[0].mass
    named.set_seed(2)
    assert named.reset()["task"][:, 0].tolist() == [6, 1]
    named.close()
    every.close()


def test_who_begins_at_another_task_has_planes_of_its_own() -> None:
    """Processes that share the tasks of an evaluation do not repeat each other's noise."""
    planes = {}
    for tasks in (None, (0, 1), (1, 0), (1, 2)):
        env = NavigationEnv(1, world=replace(AMONG_PLANES, seeds=(3,)), tasks=tasks, seed=2, blind=True)
        env.reset()
        planes[tasks] = env.plane_poses()
        env.set_seed(2)
        env.reset(task=1)
        np.testing.assert_array_equal(env.plane_poses(), planes[None], "a task that is asked for depends on itself")
        env.close()
    np.testing.assert_array_equal(planes[0, 1], planes[None])
    np.testing.assert_array_equal(planes[1, 0], planes[1, 2])
    assert not np.allclose(planes[1, 2], planes[None])


def test_a_replay_builds_the_valleys_of_its_tasks_alone(
    tmp_path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    built, build = [], world_module.build_place
    monkeypatch.setattr(
        world_module, "build_place", lambda config, n, *rest: built.append(config.seeds[n]) or build(config, n, *rest)
    )
    world = ["env.world.size=[14,12]", "env.world.obstacles=3", "env.world.min_goal_distance=5"]
    few = ["env.max_steps=2", "points=10", "progress=false", f"output={tmp_path / 'page.html'}"]
    assert in_process(command.main, "policy=best", "tasks=[0,3]", *world, *few) == 0
    drawn = {100 + int(np.random.default_rng((20_000, task)).integers(10)) for task in (0, 3)}
    assert built == sorted(drawn)
