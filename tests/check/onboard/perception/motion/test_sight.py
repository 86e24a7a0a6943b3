"""Valleys seen by vehicles that fly through them: what is static does not move, and planes do."""

from __future__ import annotations

import torch
from torchrl.envs import TransformedEnv

from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.world import WorldConfig
from uavrl.policies.baselines import VectorFieldHistogram
from uavrl.transforms import NavigationState

VEHICLES, STEPS = 10, 100


def seeing(world: WorldConfig) -> TransformedEnv:
    base = NavigationEnv(VEHICLES, world=world, lidar=LidarConfig(max_range=4.0, far_range=12.0), seed=7)
    return TransformedEnv(base, NavigationState(reduction="range_image", motion=12.0))


def test_in_a_thousand_real_scans_of_a_static_valley_nothing_moves() -> None:
    env = seeing(WorldConfig(seeds=[200, 201]))
    rule, state, alarms = VectorFieldHistogram(reduction="range_image"), env.reset(), 0
    for _ in range(STEPS):
        state, following = env.step_and_maybe_reset(rule(state))
        alarms += int((state["next", "moving_objects"].unflatten(-1, (-1, 7))[..., -1] > 0).sum())
        state = following
    env.close()
    assert alarms <= 1, f"{alarms} false alarms in {VEHICLES * STEPS} scans"


def test_what_is_seen_to_move_among_planes_is_a_plane_and_flies_as_that_does() -> None:
    """In the axes of the vehicle's yaw, from its LiDAR: the truth is turned into them."""
    env = seeing(WorldConfig(seeds=[200], planes=10))
    base, rule, state = env.base_env, VectorFieldHistogram(reduction="range_image"), env.reset()
    places, errors = [], []
    for _ in range(60):
        before = torch.from_numpy(base.plane_poses())[:, :3]
        state, following = env.step_and_maybe_reset(rule(state))
        planes, yaw = torch.from_numpy(base.plane_poses())[:, :3], state["next", "attitude"][:, 2].double()
        velocities, cos, sin = (planes - before) / 0.1, yaw.cos(), yaw.sin()
        turn = torch.stack([cos, -sin, 0 * cos, sin, cos, 0 * cos, 0 * cos, 0 * cos, 0 * cos + 1], -1).view(-1, 3, 3)
        objects = state["next", "moving_objects"].double().unflatten(-1, (-1, 7))
        for one, slot in (objects[..., -1] > 0).nonzero().tolist():
            place = turn[one] @ objects[one, slot, :3] + state["next", "position"][one].double()
            distances = (planes - place).norm(dim=-1)
            places.append(float(distances.min()))
            errors.append(float((turn[one] @ objects[one, slot, 3:6] - velocities[distances.argmin()]).norm()))
        state = following
    env.close()
    assert len(places) > 100
    assert sum(place < 1.0 for place in places) > 0.8 * len(places)
    assert sum(error < 1.0 for error in errors) > 0.7 * len(errors)
