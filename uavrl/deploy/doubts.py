"""What is odd about a flight's scans, though each of them is whole: told once, for people."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

from uavrl.deploy.reduction import is_return
from uavrl.deploy.stages import FlightCycle

UNHEARD = 3.0  # s without a scan after which it is told why
LOOKED_AT = 20  # scans
_SLOW = 0.8  # of the policy's rate
_GAP = 0.3  # s between two scans that is a silence: no sensor turns so slowly


class Doubts:
    """Looks at a flight's cycles.

    Args:
        trouble: says why no scan has come, as a sentence's second half.
        rate: how often the policy acts, Hz.
    """

    def __init__(self, trouble: Callable[[], str], rate: float) -> None:
        self._trouble, self._rate = trouble, rate
        self._heard: float | None = None  # when the latest scan came
        self._stamps: deque[float] = deque(maxlen=LOOKED_AT)
        self._empty = 0  # scans in a row without a return
        self._told = set[str]()

    def of(self, cycle: FlightCycle) -> list[str]:
        """The sentences that are new."""
        found = dict(self._found(cycle))
        new = [sentence for kind, sentence in found.items() if kind not in self._told]
        self._told.update(found)
        return new

    def _found(self, cycle: FlightCycle) -> Iterator[tuple[str, str]]:
        self._heard = cycle.time if self._heard is None or cycle.scan is not None else self._heard
        if cycle.scan is None:
            if cycle.time - self._heard > UNHEARD:
                yield "none", f"No scan has come for {UNHEARD:g} s: {self._trouble()}"
            return
        if self._stamps and cycle.scan.stamp - self._stamps[-1] > _GAP:
            self._stamps.clear()
        self._stamps.append(cycle.scan.stamp)
        self._empty = 0 if is_return(cycle.scan.points).any() else self._empty + 1
        if self._empty >= LOOKED_AT:
            empty = f"{LOOKED_AT} scans in a row hold no return at all: for the policy the way is free"
            yield "empty", f"{empty}. Is the sensor covered, or its laser off?"
        span = self._stamps[-1] - self._stamps[0]
        if len(self._stamps) == LOOKED_AT and span * _SLOW * self._rate > LOOKED_AT - 1:
            slow = f"Scans come {(LOOKED_AT - 1) / span:.1f} times a second, and the policy has learned {self._rate:g}"
            yield "slow", f"{slow}: look at the sensor's rate, and at what is lost on the way."
