"""A static valley seen by vehicles that fly through it: nothing in it moves."""

from __future__ import annotations

from torchrl.envs import TransformedEnv

from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.world import WorldConfig
from uavrl.rollout.baselines import VectorFieldHistogram
from uavrl.transforms import NavigationState

VEHICLES, STEPS = 10, 100


def test_in_a_thousand_real_scans_of_a_static_valley_nothing_moves() -> None:
    env = TransformedEnv(
        NavigationEnv(
            VEHICLES, world=WorldConfig(seeds=[200, 201]), lidar=LidarConfig(max_range=4.0, far_range=12.0), seed=7
        ),
        NavigationState(reduction="range_image", motion=12.0),
    )
    rule, state, alarms = VectorFieldHistogram(reduction="range_image"), env.reset(), 0
    for _ in range(STEPS):
        state, following = env.step_and_maybe_reset(rule(state))
        alarms += int((state["next", "moving_objects"].unflatten(-1, (-1, 7))[..., -1] > 0).sum())
        state = following
    env.close()
    assert alarms <= 1, f"{alarms} false alarms in {VEHICLES * STEPS} scans"
