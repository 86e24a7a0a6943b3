"""What a run asks of its collector."""

from collections import OrderedDict
from collections.abc import Iterator
from typing import Any, ClassVar, Protocol

from tensordict import TensorDictBase

REQUIRED = ("is_remote", "restart", "drain")  # what TorchRL's collectors lack


class EpisodeCollector(Protocol):
    """Yields whole episodes, one a batch, and can begin anew.

    One of your own subclasses a collector of uavrl's, or one of TorchRL's and adds the names in ``REQUIRED``. With
    ``copies_policy = True`` it gets a policy on the CPU, whatever the learner's device is.
    """

    is_remote: ClassVar[bool]  # in other processes than the learner's: it makes its environments itself
    init_random_frames: int

    def __iter__(self) -> Iterator[TensorDictBase]:
        """The episodes that count."""

    def restart(self, seed: int, episodes: int) -> None:
        """Drops what is open, unless it goes on, and begins from a seed; the first ``episodes`` from then on count."""

    def drain(self) -> bool:
        """Begins no episode that counts; returns whether all that count have ended."""

    def state_dict(self) -> OrderedDict[str, Any]:
        """What a checkpoint keeps."""

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""

    def shutdown(self) -> None:
        """Ends all processes."""
