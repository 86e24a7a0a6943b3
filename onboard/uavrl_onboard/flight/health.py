"""What is odd about a flight's scans and poses, though each of them is whole: for people, told now and then."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.flight.interfaces import FlightCycle

UNHEARD = 3.0  # s without a scan, or with poses that are too old, after which it is told why
AGAIN = 30.0  # s after which that is told again
_WELL = 1.0  # s for which scans or poses must come in time again before it is told that it is over
LOOKED_AT = 20  # scans
_SLOW = 0.8  # of the policy's rate
_GAP = 0.3  # s between two scans that is a silence: no sensor turns so slowly
_STANDS = 0.5  # s without a newer pose: autopilots send 50 a second
_OLD_SCAN = 0.08  # s: a stamp of the first point is older by a turn, 0.1 s at 10 Hz
_OLD_POSE = 0.06  # s: poses that come 20 times a second, stamped when they are made, are younger when they are read
_STEADY = 0.05  # s within which ages are steady
_POSES_LOOKED_AT = 30


class _Spell:
    """A fault that lasts: when it is to be told, and when it is over. What is well for a moment does not end it."""

    def __init__(self) -> None:
        self._begun, self._latest, self._told = 0.0, 0.0, 0.0
        self._lasts, self._is_told = False, False

    def tells(self, now: float, since: float | None) -> bool:
        """Whether a fault that is there since some time is to be told now; None for none."""
        if since is None:
            return False
        self._begun = self._begun if self._lasts else since
        self._lasts, self._latest = True, now
        due = now - self._told >= AGAIN if self._is_told else now - self._begun > UNHEARD
        if due:
            self._is_told, self._told = True, now
        return due

    def ends(self, now: float, since: float | None) -> float | None:
        """How long a fault has lasted that was told and is over now."""
        if since is not None or not self._lasts or now - self._latest < _WELL:
            return None
        self._lasts, told, self._is_told = False, self._is_told, False
        return self._latest - self._begun if told else None


class FlightHealth:
    """Takes in the cycles of a flight and says in sentences what is odd about them.

    Args:
        trouble: says why no scan has come, as a sentence's second half.
        rate: how often the policy acts, Hz.
        pose_age: greatest age of a pose by which the safety layer lets it fly, s.
        stamped: whether scans bear a stamp of their sender; else they have that of their arrival.
        remarks: gives what else is odd about the source of scans, each sentence again and again.

    Attributes:
        told: the latest sentence of each kind that was told: ``silent``, ``slow``, ``doubt`` and ``old scans`` of the
            scans, ``late poses`` and ``old poses``; remarks by their own sentence.
    """

    def __init__(
        self,
        trouble: Callable[[], str],
        rate: float,
        pose_age: float = 0.1,
        *,
        stamped: bool = False,
        remarks: Callable[[], list[str]] = list,
    ) -> None:
        self._trouble, self._rate, self._pose_age = trouble, rate, pose_age
        self._stamped, self._remarks = stamped, remarks
        self._heard: float | None = None  # when the latest scan came
        self._posed: tuple[float, float] | None = None  # the stamp of the latest pose, and when that was new
        self._scans, self._poses = _Spell(), _Spell()
        self._stamps: deque[float] = deque(maxlen=LOOKED_AT)
        self._scan_ages: deque[float] = deque(maxlen=LOOKED_AT)
        self._pose_ages: deque[float] = deque(maxlen=_POSES_LOOKED_AT)
        self.told: dict[str, str] = {}

    def sentences(self, cycle: FlightCycle) -> list[str]:
        """Take in a cycle and return the sentences that are new."""
        found = dict(self._found(cycle))
        new = {kind: sentence for kind, sentence in found.items() if kind not in self.told}
        late = [*self._late_scans(cycle), *self._late_poses(cycle)]
        self.told |= new
        return [*late, *new.values()]

    def _late_scans(self, cycle: FlightCycle) -> Iterator[str]:
        """What is told of scans that do not come."""
        now = cycle.time
        self._heard = now if self._heard is None or cycle.scan is not None else self._heard
        since = self._heard if now - self._heard > _GAP else None
        if self._scans.tells(now, since):
            self.told["silent"] = f"No scan has come for {now - self._heard:.0f} s: {self._trouble()}"
            yield self.told["silent"]
        if (lasted := self._scans.ends(now, since)) is not None:
            yield f"Scans come again; none had come for {lasted:.0f} s."

    def _late_poses(self, cycle: FlightCycle) -> Iterator[str]:
        """What is told of poses that do not come, or come too late to fly by."""
        now, stamp = cycle.time, None if cycle.pose is None else cycle.pose.stamp
        if self._posed is None or stamp is None or stamp > self._posed[0]:
            before = now if self._posed is None else self._posed[1]
            self._posed = (float("-inf"), before) if stamp is None else (stamp, now)
        late = stamp is None or now - stamp > self._pose_age
        since = now if late else None
        if self._poses.tells(now, since):
            self.told["late poses"] = self._why_late(cycle, stamp, now - self._posed[1])
            yield self.told["late poses"]
        if (lasted := self._poses.ends(now, since)) is not None:
            yield f"Poses are in time again; they were missing or too old for {lasted:.0f} s."

    def _why_late(self, cycle: FlightCycle, stamp: float | None, silent: float) -> str:
        if stamp is None or silent > _STANDS:
            none = "No position and attitude have come" if stamp is None else "No new position and attitude have come"
            none += f" for {silent:.0f} s"
            alive = cycle.control.control not in (Control.WAITING, Control.LOST)
            runs = "look whether the autopilot runs, whether it sends to this address, and at its link"
            sends = "look whether the autopilot's estimator has a position, whether it sends both, and at its link"
            return f"{none}, so nothing is flown ({cycle.control.sentence}): {sends if alive else runs}."
        old = f"Poses are {cycle.time - stamp:.1f} s old, and nothing is flown by one older than {self._pose_age:g} s"
        why = "their sender's clock is slower than ours, as a starved simulator's is, or they wait on their way"
        look = "look at the sender, its rate, and the processor's load"
        return f"{old}: {why}; {look} (a second makes up for 0.1 s at most)."

    def _found(self, cycle: FlightCycle) -> Iterator[tuple[str, str]]:
        """What is told once."""
        yield from ((sentence, sentence) for sentence in self._remarks())
        if cycle.scan is None:
            return
        if self._stamps and cycle.scan.stamp - self._stamps[-1] > _GAP:
            self._stamps.clear()
        self._stamps.append(cycle.scan.stamp)
        if cycle.doubt is not None:
            yield "doubt", f"{cycle.doubt[0].upper()}{cycle.doubt[1:]}"
        yield from self._old_stamps(cycle.time, cycle.scan.stamp, None if cycle.pose is None else cycle.pose.stamp)
        span = self._stamps[-1] - self._stamps[0]
        if len(self._stamps) == LOOKED_AT and span * _SLOW * self._rate > LOOKED_AT - 1:
            slow = f"Scans come {(LOOKED_AT - 1) / span:.1f} times a second, and the policy has learned {self._rate:g}"
            yield "slow", f"{slow}: look at the sensor's rate, at what is lost on the way, and at the processor's load."

    def _old_stamps(self, now: float, scan: float, pose: float | None) -> Iterator[tuple[str, str]]:
        """What is told of stamps that are old at once, and steadily."""
        self._scan_ages.append(now - scan)
        age = float(np.median(self._scan_ages))
        if len(self._scan_ages) == LOOKED_AT and age > _OLD_SCAN:
            header = "is header.stamp that of the first point? It must be that of the last one"
            waits = "look at the processor's load, and at what holds packets up on their way"
            yield "old scans", f"Scans are {age:.2f} s old when they arrive: {header if self._stamped else waits}."
        if pose is None:
            self._pose_ages.clear()
            return
        self._pose_ages.append(now - pose)
        youngest, spread = min(self._pose_ages), max(self._pose_ages) - min(self._pose_ages)
        if len(self._pose_ages) == _POSES_LOOKED_AT and youngest > _OLD_POSE and spread < _STEADY:
            cause = "is their stamp that of an earlier measurement, or do they come less than 20 times a second?"
            yield "old poses", f"Poses are {youngest:.2f} s old or older whenever a scan comes: {cause}"
