"""What the benchmarks share: the default experiment, and on what machine they run."""

from __future__ import annotations

import os
import warnings
from typing import Any

import numpy as np

from uavrl.config import TrainConfig, compose, validate
from uavrl.runs.provenance import processor, versions

PRIZE = 200.0  # what reward=navigation_prize, the default, adds to a success


def experiment(*overrides: str) -> TrainConfig:
    """Returns the checked configuration of `uavrl-train OVERRIDES`."""
    return validate(compose(*overrides))


def machine() -> dict[str, Any]:
    """Returns the processor and the versions that decide the speed."""
    return {
        "cpu": processor()["model"],
        "cores": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        **versions(),
    }


def valley_with_prize() -> Any:
    """Returns `uavrl/Valley-v0` with the default's reward: that of Eq. 3.6 and 200 for a success."""
    import gymnasium

    class Prize(gymnasium.Wrapper):
        def step(self, action: Any) -> Any:
            state, reward, terminated, truncated, info = self.env.step(action)
            return state, float(reward) + PRIZE * info["is_success"], terminated, truncated, info

    return Prize(gymnasium.make("uavrl:uavrl/Valley-v0"))


def sb3_td3(env: Any, *, learning_starts: int, seed: int) -> Any:
    """Stable-Baselines3's TD3 with our sizes; what is not said here is its default, as is ours.

    It knows one learning rate: ours are 1e-3 and, for the actor, 1e-4. It makes one update for each step of a vehicle.
    """
    from stable_baselines3 import TD3
    from stable_baselines3.common.noise import NormalActionNoise

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a buffer larger than the memory: its pages are touched one by one
        return TD3(
            "MlpPolicy",
            env,
            learning_rate=1e-3,
            buffer_size=1_000_000,
            learning_starts=learning_starts,
            batch_size=100,
            gamma=0.99,
            tau=0.005,
            train_freq=1,
            gradient_steps=-1,  # as many as steps, also of several vehicles
            policy_delay=2,
            action_noise=NormalActionNoise(np.zeros(4), np.full(4, 0.1)),  # of actions in [-1, 1]
            policy_kwargs={"net_arch": [400, 300]},
            device="cpu",
            seed=seed,
        )
