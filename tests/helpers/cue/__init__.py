"""A task that nobody solves who remembers nothing: what is to be done is shown once, at the start."""

from __future__ import annotations

from pathlib import Path

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from uavrl_onboard.ranges import Count

CONFIG_DIR, TRUSTED = ["--config-dir", str(Path(__file__).parent / "conf")], "packages=[tests]"


class CueEnv(EnvBase):
    """The first observation shows -1 or 1, all others 0; the reward asks for actions of that sign until the end.

    An episode arrives if the last action is within 0.5 of what was shown: the same action for both is within 0.5 of one
    at most. ``cue`` says at every step what was shown, and the observation does not hold it.
    """

    def __init__(self, num_uavs: Count = 8, max_steps: Count = 5, seed: int = 0) -> None:
        super().__init__(batch_size=torch.Size([num_uavs]))
        self.steps_of_episode = max_steps

        def flag() -> Binary:
            return Binary(1, (num_uavs, 1), dtype=torch.bool)

        entries = {key: Unbounded((num_uavs, 1), dtype=torch.float32) for key in ("cue", "speed")}
        entries["observation"] = Unbounded((num_uavs, 2), dtype=torch.float32)
        entries["task"] = Unbounded((num_uavs, 1), dtype=torch.int64)
        self.observation_spec = Composite({**entries, "arrived": flag(), "collided": flag()}, shape=(num_uavs,))
        self.action_spec = Bounded(-1.0, 1.0, (num_uavs, 1), dtype=torch.float32)
        self.reward_spec = Unbounded((num_uavs, 1), dtype=torch.float32)
        ends = {key: flag() for key in ("done", "terminated", "truncated")}
        self.done_spec = Composite(ends, shape=(num_uavs,))
        self.steps, self.task = torch.zeros((2, num_uavs, 1), dtype=torch.int64)
        self.cue = torch.zeros(num_uavs, 1)
        self.set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        self.tasks_begun, self._generator = 0, torch.Generator().manual_seed(seed or 0)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        mask = torch.ones(self.batch_size, dtype=torch.bool) if mask is None else mask.reshape(-1)
        for row in mask.nonzero().flatten().tolist():
            self.task[row], self.steps[row] = self.tasks_begun, 0
            self.cue[row] = 2.0 * torch.randint(2, (), generator=self._generator) - 1.0
            self.tasks_begun += 1
        no = torch.zeros_like(self.steps, dtype=torch.bool)
        return self._seen(no).update({"done": no, "terminated": no.clone(), "truncated": no.clone()})

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self.steps = self.steps + 1
        error = (tensordict["action"] - self.cue).abs()
        ended = self.steps >= self.steps_of_episode
        ends = {"done": ended, "terminated": ended.clone(), "truncated": torch.zeros_like(ended)}
        return self._seen(ended & (error < 0.5)).update({**ends, "reward": -error})

    def _seen(self, arrived: torch.Tensor) -> TensorDict:
        shown = torch.where(self.steps == 0, self.cue, 0.0)
        observation = torch.cat([shown, self.steps / self.steps_of_episode], -1)
        seen = {"observation": observation, "cue": self.cue.clone(), "speed": 3 * self.cue, "task": self.task.clone()}
        collided = torch.zeros_like(arrived)
        return TensorDict({**seen, "arrived": arrived, "collided": collided}, self.batch_size)
