"""Remarks for the operator on scans and poses that are late, slow or doubtful although each one is valid."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.flight.interfaces import FlightCycle

UNHEARD = 3.0  # After this many seconds without a scan, or with poses that are too old, the operator learns why.
AGAIN = 30.0  # The sentence is repeated after this many seconds.
_WELL = 1.0  # Scans or poses must be in time for this many seconds before the fault counts as over.
LOOKED_AT = 20  # number of latest scans that are examined
_SLOW = 0.8  # Scans are slow below this share of the policy's rate.
_GAP = 0.3  # A longer time between two scans, in s, is a silence, because no sensor turns so slowly.
_STANDS = 0.5  # After this many seconds without a newer pose, poses have stopped: autopilots send 50 per second.
_OLD_SCAN = 0.08  # A scan that is older on arrival, in s, may have the stamp of its first point: a turn takes 0.1 s.
_OLD_POSE = 0.06  # Poses that come 20 times per second and are stamped when they are made are younger than this, in s.
_STEADY = 0.05  # Ages that differ by less than this, in s, are steady.
_POSES_LOOKED_AT = 30  # number of latest poses that are examined


class _Spell:
    """A lasting fault, which decides when it is reported and when it is over; a short improvement does not end it."""

    def __init__(self) -> None:
        self._begun, self._latest, self._told = 0.0, 0.0, 0.0
        self._lasts, self._is_told = False, False

    def tells(self, now: float, since: float | None) -> bool:
        """Return whether to report now a fault that exists ``since`` a time; None stands for no fault."""
        if since is None:
            return False
        self._begun = self._begun if self._lasts else since
        self._lasts, self._latest = True, now
        due = now - self._told >= AGAIN if self._is_told else now - self._begun > UNHEARD
        if due:
            self._is_told, self._told = True, now
        return due

    def ends(self, now: float, since: float | None) -> float | None:
        """Return how long a fault has lasted if it was reported and is over now; else None."""
        if since is not None or not self._lasts or now - self._latest < _WELL:
            return None
        self._lasts, told, self._is_told = False, self._is_told, False
        return self._latest - self._begun if told else None


class FlightHealth:
    """Observe the cycles of a flight and describe in sentences what is wrong with its scans and poses.

    Args:
        trouble: returns the second half of a sentence, which says why no scan has come.
        rate: number of actions of the policy per second, Hz.
        pose_age: the greatest age of a pose by which the safety layer lets the policy fly, s.
        stamped: True if scans have the stamp of their sender; False if they have the time of their arrival.
        remarks: returns further sentences about the source of the scans; it may repeat them at each call.

    Attributes:
        told: the latest sentence of each kind that was reported. The kinds are ``silent``, ``slow``, ``doubt`` and
            ``old scans`` for scans, and ``late poses`` and ``old poses``. The kind of a remark is its own sentence.
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
        self._heard: float | None = None  # time of the latest scan
        self._posed: tuple[float, float] | None = None  # stamp of the latest pose, and the time at which it was new
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
        """Yield sentences about missing scans."""
        now = cycle.time
        self._heard = now if self._heard is None or cycle.scan is not None else self._heard
        since = self._heard if now - self._heard > _GAP else None
        if self._scans.tells(now, since):
            self.told["silent"] = f"No scan has come for {now - self._heard:.0f} s: {self._trouble()}"
            yield self.told["silent"]
        if (lasted := self._scans.ends(now, since)) is not None:
            yield f"Scans come again; none had come for {lasted:.0f} s."

    def _late_poses(self, cycle: FlightCycle) -> Iterator[str]:
        """Yield sentences about poses that are missing, or too old to fly by."""
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
        """Return a sentence that says why poses are late, and what to do."""
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
        """Yield the kinds and sentences that are reported once."""
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
        """Yield the kinds and sentences about scans and poses whose stamps are always old on arrival."""
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
