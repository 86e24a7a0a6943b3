"""Acting without exploration noise, in programs with several threads, too."""

from collections.abc import Iterator
from contextlib import contextmanager

from torchrl.envs.utils import ExplorationType, set_exploration_type

from uavrl.locks import OneAtATime

_ONE_AT_A_TIME = OneAtATime()


@contextmanager
def deterministic() -> Iterator[None]:
    """Lets policies act without noise; one thread at a time.

    TorchRL has one exploration type for the whole process. Of two threads that changed it side by side, the one that
    ended last would leave it at what the other one had set.
    """
    with _ONE_AT_A_TIME, set_exploration_type(ExplorationType.DETERMINISTIC):
        yield
