"""Flying and learning in turn, in one process."""

import math
from collections.abc import Iterator
from typing import Any, ClassVar

from tensordict import TensorDictBase
from torchrl.collectors import Collector


class SyncCollector(Collector):
    """TorchRL's collector in this process, which counts flights by when they begin and never by how they end.

    Whoever stops counting at some moment and drops what is open drops long flights more often than short ones. Here all
    flights up to the last that counts are yielded, and none that begins later; until told otherwise all count. The
    environment numbers them: it emits ``task``, 0, 1, 2 … in the order in which they begin after ``set_seed``, and
    knows ``tasks_begun``.
    """

    is_remote: ClassVar[bool] = False

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._counted: float = math.inf
        self._ended = 0

    def restart(self, seed: int, flights: int) -> None:
        """Builds the environment anew from a seed and drops what is open; the first ``flights`` from here on count."""
        self._counted, self._ended = flights, 0
        self.set_seed(seed, static_seed=True)
        self.reset()

    def drain(self) -> bool:
        """Counts no flight that begins after the first call; tells whether all that count have ended."""
        self._counted = min(self._counted, self.getattr_env("tasks_begun"))
        return self._ended == self._counted

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Yields the flights that count."""
        for flight in super().__iter__():
            if flight["task"][0].item() < self._counted:
                self._ended += 1
                yield flight
