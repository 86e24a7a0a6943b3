"""An environment of one's own: it emits ``observation``, ``arrived``, ``collided`` and the number of its ``task``."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from uavrl_onboard.ranges import Count, Positive


class Corridor(EnvBase):
    """A point flies along a corridor of 2 m without touching its walls, up to 0.2 m a step along each axis."""

    def __init__(self, length: Positive = 2.0, max_steps: Count = 40, seed: int = 0) -> None:
        super().__init__()
        self.length, self.max_steps = length, max_steps
        flags = {key: Binary(1, dtype=torch.bool) for key in ("arrived", "collided")}
        self.observation_spec = Composite(observation=Unbounded(2), task=Unbounded(1, dtype=torch.int64), **flags)
        self.action_spec, self.reward_spec = Bounded(-0.2, 0.2, (2,)), Unbounded(1)
        self.done_spec = Composite({key: Binary(1, dtype=torch.bool) for key in ("done", "terminated", "truncated")})
        self.set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        self.tasks_begun, self._generator = 0, torch.Generator().manual_seed(seed or 0)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDict:
        self._place, self._steps = torch.tensor([0.0, torch.rand((), generator=self._generator).item() - 0.5]), 0
        self.tasks_begun += 1
        return TensorDict(self._seen())

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self._place, self._steps = self._place + tensordict["action"], self._steps + 1
        seen, late = self._seen(), torch.tensor([self._steps >= self.max_steps])
        ended = seen["arrived"] | seen["collided"]
        ends = {"terminated": ended, "truncated": late & ~ended, "done": ended | late}
        return TensorDict({**seen, **ends, "reward": torch.zeros(1)})

    def _seen(self) -> dict[str, torch.Tensor]:
        x, y = self._place[:1], self._place[1:]
        hit = (y.abs() > 1) | (x < -1)
        task = torch.tensor([self.tasks_begun - 1])
        return {"observation": self._place, "arrived": (x >= self.length) & ~hit, "collided": hit, "task": task}
