"""What only a simulator knows, and that only critics read it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from uavrl.envs import NavigationEnv
from uavrl.envs.privileged import QUANTITIES, nearest_planes
from uavrl.envs.traffic import Traffic
from uavrl.envs.world import World, WorldConfig
from uavrl.errors import UavrlError
from uavrl_onboard.geometry import world_to_yaw

WORLD = WorldConfig(size=(14, 12), obstacles=3, min_goal_distance=4, planes=2, plane_keep_out=1)


def test_it_is_emitted_where_it_is_asked_for_alone() -> None:
    asked = NavigationEnv(
        1,
        world=WORLD,
        privileged=["wind", "planes", "clearance", "way", "mapped_way", "traps"],
        aerodynamics={"wind": (3, 0, 0)},
    )
    plain = NavigationEnv(1, world=WORLD, aerodynamics={"wind": (3, 0, 0)})
    one, other = asked.rollout(3)["next"], plain.rollout(3)["next"]
    assert set(one.keys()) - set(other.keys()) == set(QUANTITIES)
    for key, quantity in QUANTITIES.items():
        assert one[key].shape[-1] == len(quantity.signs)
    torch.testing.assert_close(one["wind"].norm(dim=-1), torch.full((1, 3), 3.0))
    yaw = one["attitude"][0, -1, 2].item()
    np.testing.assert_allclose(one["wind"][0, -1], world_to_yaw(np.array([3.0, 0, 0]), yaw), atol=1e-5)
    simulation, traffic = asked.simulation, asked.traffic
    near = nearest_planes(simulation.position, simulation.yaw, traffic.positions, traffic.velocities())
    assert np.abs(near).max() > 0.1
    np.testing.assert_allclose(one["planes"][0, -1], near[0], atol=1e-5)
    distance = float(simulation.closest_distance().item())
    assert one["clearance"][0, -1].item() == pytest.approx(distance, abs=1e-5) and distance > 0
    asked.close(), plain.close()


def test_the_velocities_of_planes_are_those_of_their_next_positions() -> None:
    traffic = Traffic(World(WORLD), np.random.default_rng(0))
    for _ in range(20):
        before, velocities = traffic.positions, traffic.velocities()
        traffic.advance(24, 1 / 240)
        moved = (traffic.positions - before) / 0.1
        usual = np.linalg.norm(moved, axis=1) < 10  # not one that came in elsewhere
        straight = usual & (np.abs(moved - velocities).max(1) < 0.5)
        assert straight.sum() >= usual.sum() - 1, "one may turn at a corner"


def test_far_planes_are_absent_and_near_ones_come_first() -> None:
    planes = np.array([[0.0, 0.0, 30.0], [0.0, 4.0, 0.0], [2.0, 0.0, 0.0]])
    told = nearest_planes(np.zeros((1, 3)), np.array([np.pi / 2]), planes, np.ones((3, 3))).reshape(3, 6)
    np.testing.assert_allclose(told[0, :3], [0.0, -0.9, 0.0], atol=1e-9)
    np.testing.assert_allclose(told[1, :3], [0.8, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(told[0, 3:], [0.25, -0.25, 0.25], atol=1e-9)
    assert not told[2].any()


def test_traps_are_those_of_the_valley_that_a_vehicle_is_in() -> None:
    world = WorldConfig(seeds=(100, 101, 102, 103), obstacles=5, traps=(0, 3))
    env = NavigationEnv(6, world=world, privileged=["traps"], blind=True, max_steps=2)
    found = env.rollout(8, break_when_any_done=False)
    built = torch.where(found["world_seed"] % 2 == 1, 3.0, 0.0)
    assert built.unique().tolist() == [0.0, 3.0], "valleys of both kinds were drawn"
    torch.testing.assert_close(found["traps"], built)
    env.close()


def test_traps_are_right_where_some_of_the_valleys_are_built() -> None:
    world = WorldConfig(seeds=tuple(range(100, 108)), obstacles=5, traps=(0, 0, 0, 3))
    env = NavigationEnv(1, world=world, privileged=["traps"], blind=True, tasks=range(3), max_steps=1)
    found = env.rollout(3, break_when_any_done=False)
    torch.testing.assert_close(found["traps"], torch.where(found["world_seed"] % 4 == 3, 3.0, 0.0))
    assert len(env.world.places) < 8
    env.close()


def test_another_quantity_is_refused() -> None:
    with pytest.raises(
        UavrlError, match="privileged takes any of clearance, planes, wind, way, mapped_way, traps, got sun"
    ):
        NavigationEnv(1, privileged=["sun"])
