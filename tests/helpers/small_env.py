"""A batched environment of a few lines that emits what the navigation transforms read."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase


class SmallEnv(EnvBase):
    """Three bodies on a line; every quantity follows from the position."""

    def __init__(self) -> None:
        super().__init__(batch_size=torch.Size([3]))
        flag = Binary(n=1, shape=(3, 1), dtype=torch.bool)
        entries = {key: Unbounded(shape=(3, 1)) for key in ("distance", "altitude", "heading_deg", "elevation_deg")}
        self.observation_spec = Composite(
            {**entries, "faces": Unbounded(shape=(3, 32)), "arrived": flag, "collided": flag.clone()}, shape=(3,)
        )
        self.action_spec = Bounded(-2.0, 2.0, shape=(3, 4))
        self.reward_spec = Unbounded(shape=(3, 1))
        self.done_spec = Composite({"done": flag.clone(), "terminated": flag.clone()}, shape=(3,))
        self._distance = torch.full((3, 1), 5.0)

    def _observe(self) -> TensorDict:
        no = torch.zeros(3, 1, dtype=torch.bool)
        data = {
            "distance": self._distance.clone(),
            "altitude": torch.full((3, 1), 3.5),
            "heading_deg": self._distance * 10 % 360,
            "elevation_deg": torch.zeros(3, 1),
            "faces": self._distance.expand(3, 32).clone(),
            "arrived": no,
            "collided": no.clone(),
            "done": no.clone(),
            "terminated": no.clone(),
        }
        return TensorDict(data, [3])

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        mask = torch.ones(3, 1, dtype=torch.bool) if tensordict is None else tensordict.get("_reset", None)
        mask = torch.ones(3, 1, dtype=torch.bool) if mask is None else mask.reshape(3, 1)
        self._distance = torch.where(mask, 5.0, self._distance)
        return self._observe()

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self._distance = self._distance - tensordict["action"][:, :1] / 10
        return self._observe().set("reward", torch.zeros(3, 1))

    def _set_seed(self, seed: int | None) -> None:
        pass
