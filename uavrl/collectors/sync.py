"""Collecting and learning in turn, in one process."""

import math
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase


class SyncCollector(Collector):
    """TorchRL's collector in this process, which selects episodes by their start, so that no outcome is favoured.

    All episodes up to the last that counts are yielded, and none that begins later; at first all count. The environment
    numbers them: it emits ``task``, 0, 1, 2 … in the order in which they begin after ``set_seed``, and knows
    ``tasks_begun``.
    """

    is_remote: ClassVar[bool] = False

    def __init__(
        self, create_env_fn: Callable[[], EnvBase], policy: Callable[..., Any] | None = None, **kwargs: Any
    ) -> None:
        super().__init__(create_env_fn, policy, **kwargs)
        self._counted: float = math.inf
        self._ended = 0

    def restart(self, seed: int, episodes: int) -> None:
        """Builds the environment anew from a seed and drops what is open; the first ``episodes`` from here on count."""
        self._counted, self._ended = episodes, 0
        self.set_seed(seed, static_seed=True)
        self.reset()

    def drain(self) -> bool:
        """Counts no episode that begins after the first call; returns whether all that count have ended."""
        self._counted = min(self._counted, self.getattr_env("tasks_begun"))
        return self._ended == self._counted

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Yields the episodes that count."""
        for episode in super().__iter__():
            if episode["task"][0].item() < self._counted:
                self._ended += 1
                yield episode
