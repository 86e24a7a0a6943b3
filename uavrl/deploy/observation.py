"""The policy's state in numpy, as a contract describes it: what :mod:`uavrl.transforms` makes in training."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from uavrl.deploy.contract import Contract


class PolicyState:
    """The last observations in a row, oldest first, padded before the first: what a policy reads.

    Args:
        contract: says which quantities an observation has, in which order, and how they are scaled.
    """

    def __init__(self, contract: Contract) -> None:
        self._entries, self._padding = contract.observation, contract.state.padding
        self._past: deque[np.ndarray] = deque(maxlen=contract.state.frames)
        self.reset()

    def reset(self) -> None:
        """Forgets all observations, as at the beginning of an episode."""
        width = sum(entry.size for entry in self._entries)
        self._past.extend([np.full(width, self._padding, np.float32)] * (self._past.maxlen or 0))

    def __call__(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Adds an observation of these quantities, each in its unit, and returns the state, ``float32 [S]``."""
        scaled = []
        for entry in self._entries:
            value = np.asarray(values[entry.name], np.float32).reshape(entry.size) + np.float32(entry.shift)
            value = value if entry.modulo is None else value % np.float32(entry.modulo)
            scaled.append(value / np.float32(entry.divisor) + np.float32(entry.offset))
        self._past.append(np.concatenate(scaled))
        return np.concatenate(self._past)
