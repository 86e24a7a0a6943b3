"""Random clouds of points, for what reduces them."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase


class CloudEnv(EnvBase):
    """Emits random clouds of 50 points under ``key``."""

    def __init__(self, batch_size: tuple[int, ...] = (), key: object = "point_cloud") -> None:
        super().__init__(batch_size=torch.Size(batch_size))
        self.key = key
        self.observation_spec = Composite(shape=batch_size)
        self.observation_spec[key] = Unbounded((*batch_size, 50, 3))
        self.action_spec = Bounded(-1.0, 1.0, (*batch_size, 2))
        self.reward_spec = Unbounded((*batch_size, 1))
        self.generator = torch.Generator()
        self._set_seed(0)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(seed or 0)

    def _reset(self, tensordict: TensorDict | None) -> TensorDict:
        cloud = torch.randn(*self.batch_size, 50, 3, generator=self.generator) * 3
        return TensorDict({}, self.batch_size).set(self.key, cloud)

    def _step(self, tensordict: TensorDict) -> TensorDict:
        flags = {key: torch.zeros(*self.batch_size, 1, dtype=torch.bool) for key in ("done", "terminated")}
        return self._reset(None).update({"reward": torch.ones(*self.batch_size, 1), **flags})


class OfClouds:
    """What the contract of a transform of clouds asks for, beside the transform."""

    @staticmethod
    def make_env() -> CloudEnv:
        return CloudEnv((3,))

    def make_data(self, *batch: int) -> TensorDict:
        generator = torch.Generator().manual_seed(0)
        return TensorDict({"point_cloud": torch.randn(*batch, 60, 3, generator=generator)}, batch)
