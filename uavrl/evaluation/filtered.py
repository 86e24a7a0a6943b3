"""Any policy whose velocities something else changes before they are flown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from uavrl.transforms.state import ACTION_LIMIT


class Filtered(TensorDictModuleBase):
    """Flies what ``velocities`` makes of what a policy asks for; the yaw rate stays.

    Args:
        policy: writes ``action``.
        reads: the keys that it needs beside what the policy reads.
    """

    def __init__(self, policy: Callable[[TensorDictBase], TensorDictBase], reads: Sequence[str]) -> None:
        super().__init__()
        self.policy: Any = policy
        self.reads = tuple(reads)
        self.in_keys = [*dict.fromkeys([*getattr(policy, "in_keys", ()), *reads])]
        self.out_keys = list(getattr(policy, "out_keys", ["action"]))
        if hasattr(policy, "flown"):
            self.flown = policy.flown

    def velocities(self, asked: np.ndarray, seen: Mapping[str, np.ndarray]) -> np.ndarray:
        """The velocities ``[N, 3]`` to fly in place of those ``asked`` for, by what was read of each vehicle."""
        raise NotImplementedError

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``, within its limits, and tells a policy that keeps its last action what is flown."""
        tensordict = self.policy(tensordict)
        acted, dims = tensordict["action"], tensordict["action"].ndim - 1
        asked = acted.detach().cpu().reshape(-1, *acted.shape[dims:]).clamp(-ACTION_LIMIT, ACTION_LIMIT)
        read = {key: tensordict[key].detach().cpu() for key in self.reads}
        seen = {key: value.reshape(-1, *value.shape[dims:]).numpy() for key, value in read.items()}
        asked[:, :3] = torch.from_numpy(self.velocities(asked[:, :3].numpy(), seen))
        if hasattr(self, "flown"):
            self.flown(asked.numpy())
        return tensordict.set("action", asked.view(acted.shape).to(acted))
