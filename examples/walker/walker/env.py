"""Gymnasium's hard-core bipedal walker, with the signals that a training reads."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.error import DependencyNotInstalled
from tensordict import TensorDictBase
from torchrl.data import Binary, Unbounded
from torchrl.envs import GymWrapper

from uavrl.errors import UavrlError
from uavrl_onboard.ranges import Count

FALL_REWARD = -100.0  # what Gymnasium gives for the step that falls, and for no other


class BipedalEnv(GymWrapper):
    """``BipedalWalkerHardcore-v3`` (Chansuparp (2022), §4.5): two legs over ladders, stumps and pitfalls.

    The observation is Gymnasium's: 14 numbers of the body and 10 rays of a LiDAR. An episode ends by a fall
    (``collided``: the hull touches the ground, or the walker leaves the course at its start), at the end of the course
    (``arrived``), or after ``max_steps`` (``truncated``, from which a learner bootstraps). ``episode_reward`` is the
    return so far as Gymnasium gives it.

    Task number ``k`` after ``set_seed(s)`` depends on ``(s, k)`` alone, as in the valley: each episode gets a
    physics world of its own, since an episode in a Box2D world that was used before differs in its last digits.

    Args:
        max_steps: steps until an episode is truncated (Gymnasium: 2000).
        seed: seed of the courses.
        **kwargs: for TorchRL's wrapper, whose metaclass passes some.

    Raises:
        UavrlError: where Box2D is not installed.
    """

    _env: gymnasium.Env

    def __init__(self, max_steps: Count = 2000, seed: int = 0, **kwargs: Any) -> None:
        self.__dict__.update(_max_steps=max_steps, _courses_seed=seed, _next_task=0, _task=0)
        super().__init__(_make(max_steps), **kwargs)
        flag = Binary(n=1, shape=(1,), dtype=torch.bool)
        self.observation_spec["arrived"], self.observation_spec["collided"] = flag, flag.clone()
        self.observation_spec["task"] = Unbounded(shape=(1,), dtype=torch.int64)
        self.observation_spec["episode_reward"] = Unbounded(shape=(1,), dtype=torch.float32)

    def _set_seed(self, seed: int | None) -> None:
        self._courses_seed, self._next_task = 0 if seed is None else int(seed), 0

    @property
    def tasks_begun(self) -> int:
        """How many courses were begun since ``set_seed``: the number of the next one."""
        return self._next_task

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        self._env.close()
        self._env = _make(self._max_steps)
        course = int(np.random.SeedSequence([self._courses_seed, self._next_task]).generate_state(1)[0])
        self._task, self._next_task = self._next_task, self._next_task + 1
        first = super()._reset(tensordict, seed=course)
        nothing = torch.zeros(1, dtype=torch.bool)
        self._return = torch.zeros(1)
        return self._with_signals(first, nothing, nothing.clone())

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        after = super()._step(tensordict)
        self._return = self._return + after["reward"]
        fell = after["terminated"] & (after["reward"] == FALL_REWARD)
        return self._with_signals(after, after["terminated"] & ~fell, fell)

    def _with_signals(self, tensordict: TensorDictBase, arrived: torch.Tensor, fell: torch.Tensor) -> TensorDictBase:
        signals = {"arrived": arrived, "collided": fell, "task": torch.tensor([self._task])}
        return tensordict.update({**signals, "episode_reward": self._return})


def _make(max_steps: int) -> gymnasium.Env:
    try:
        return gymnasium.make("BipedalWalkerHardcore-v3", max_episode_steps=max_steps, disable_env_checker=True)
    except DependencyNotInstalled as error:
        raise UavrlError(
            "env=bipedal_hardcore needs Box2D, which is not installed: pip install 'gymnasium[box2d]'."
        ) from error
