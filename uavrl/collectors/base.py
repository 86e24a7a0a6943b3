"""What a run asks of its collector."""

from collections import OrderedDict
from collections.abc import Iterator
from typing import Any, ClassVar, Protocol

from tensordict import TensorDictBase

OURS = ("flies_elsewhere", "start_anew", "wind_down")  # what TorchRL's collectors lack


class FlightCollector(Protocol):
    """Yields whole episodes, one a batch, and can begin anew.

    One of your own subclasses a collector of uavrl's, or one of TorchRL's and adds the names in ``OURS``. With
    ``flies_copies = True`` it gets a policy on the CPU, whatever the learner's device is.
    """

    flies_elsewhere: ClassVar[bool]  # in other processes than the learner's: it makes its environments itself
    init_random_frames: int

    def __iter__(self) -> Iterator[TensorDictBase]:
        """The episodes that count."""

    def start_anew(self, seed: int, flights: int) -> None:
        """Drops what is open, unless it goes on, and begins from a seed; the first ``flights`` from then on count."""

    def wind_down(self) -> bool:
        """Begins no episode that counts; returns whether all that count have ended."""

    def state_dict(self) -> OrderedDict[str, Any]:
        """What a checkpoint keeps."""

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""

    def shutdown(self) -> None:
        """Ends all processes."""
