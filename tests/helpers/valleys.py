"""A small valley and a LiDAR that looks no farther than the reduction, and how to fly and compare there."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.world import WorldConfig

NEAR = LidarConfig(max_range=4.0)
SMALL = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=4.0)


def act(state: TensorDictBase, *action: float) -> TensorDictBase:
    return state.set("action", torch.tensor(action or (0.0,) * 4).expand(*state.batch_size, 4).clone())


def rollout(env: NavigationEnv, steps: int, seed: int = 0) -> TensorDictBase:
    """Steps with random actions of a generator of its own, through resets."""
    generator = torch.Generator().manual_seed(seed)
    state, seen = env.reset(), []
    for _ in range(steps):
        state["action"] = 4 * torch.rand(*env.batch_size, 4, generator=generator) - 2
        stepped, state = env.step_and_maybe_reset(state)
        seen.append(stepped.clone())
    return torch.stack(seen, 1)


def differing(one: TensorDictBase, other: TensorDictBase) -> list[Any]:
    """The keys that are not bit-identical; NaN equals NaN."""
    flat = [dict(td.items(True, True)) for td in (one, other)]
    assert flat[0].keys() == flat[1].keys()
    return [
        k
        for k in flat[0]
        if not np.array_equal(*(f[k].numpy() for f in flat), equal_nan=flat[0][k].is_floating_point())
    ]
