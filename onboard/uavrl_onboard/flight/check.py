"""A check before take-off: what sensor and autopilot send, and whether a flight can be made of it.

A real `Flight` flies for some seconds into nothing: the policy and its guards act on the real scans and poses, and what
they ask for is sent to nobody. `uavrl_onboard.flight.check_items` judges what came.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.enums import StrEnum
from uavrl_onboard.flight.health import UNHEARD, FlightHealth
from uavrl_onboard.flight.interfaces import FlightCycle, ScanFeed, VehicleLink
from uavrl_onboard.flight.limits import SafetyLimits
from uavrl_onboard.flight.loop import Flight, fly
from uavrl_onboard.flight.plausible import PoseCheck
from uavrl_onboard.flight.safety import ZEROS, Cycle, Reason, SafetyLayer, SafetyStatus
from uavrl_onboard.policy.contract import Contract
from uavrl_onboard.vehicle import Vehicle

OBSERVED = 6.0
"""Time for which a check listens, s: a silent sensor is told after 3 s, a driver's window after 2 s of scans."""
SETTLED = 1.0
"""Time after the first scan or pose in which nothing is judged, s: an autopilot sends poses faster once it is asked."""
SELDOM = 0.05
"""Share of the cycles in which a rule may be broken for a warning; beyond it the item fails."""
_FAR = 1e6  # m, where no fence is


class Level(StrEnum):
    """How an item of a check has come out."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"


class Item(NamedTuple):
    """One line of a check."""

    name: str
    level: Level
    sentence: str


class Listener:
    """A link to a vehicle that is listened to, as a `VehicleLink` of a flight into nothing.

    It sends what a companion sends of itself, heartbeats and requests for poses. It sends no set-points, and asks for
    no mode and no arming.

    Args:
        link: to the vehicle, which asks for no mode.

    Attributes:
        heard: the latest status of the vehicle.
    """

    def __init__(self, link: VehicleLink) -> None:
        self._link = link
        self.heard = VehicleStatus(Control.WAITING, "nothing was read yet")

    def receive(self, now: float) -> None:
        """Reads all that has come."""
        self._link.receive(now)

    def pose(self) -> Pose | None:
        """Where the vehicle was last."""
        return self._link.pose()

    def status(self, now: float) -> VehicleStatus:
        """The policy flies, into nothing; what the vehicle says is in ``heard``."""
        self.heard = self._link.status(now)
        return VehicleStatus(Control.IN_CONTROL, "a check: set-points are sent to nobody")

    def send(self, setpoint: Sequence[float] | np.ndarray | None, now: float) -> None:
        """Sends no set-point."""
        self._link.send(None, now)

    def fileno(self) -> int | None:
        """What the system can wait for."""
        return self._link.fileno()

    def close(self) -> None:
        """Gives back what the link has opened."""
        self._link.close()


def everywhere(limits: SafetyLimits) -> SafetyLimits:
    """Return the same limits without a fence: before take-off a vehicle stands below the fence's floor."""
    return replace(limits, floor=-_FAR, ceiling=_FAR, box=None)


@dataclass(frozen=True)
class Setup:
    """What is to be flown, with what.

    Args:
        contract: of the policy.
        goal: x, y, z in the world's axes, m.
        limits: of the safety layer in flight.
        vehicle: its hull and LiDAR.
        feed: of scans.
        stamped: whether scans bear a stamp of their sender.
        link: to the vehicle; None where none is flown.
        sights: how far each guard looks, m, by its name.
        uses_motion: whether the policy or a guard reads velocity, roll and pitch.
        log: file of the flight log; None for none.
        seconds: longest time of the flight, s; None where it is open.
    """

    contract: Contract
    goal: Sequence[float]
    limits: SafetyLimits
    vehicle: Vehicle
    feed: ScanFeed
    stamped: bool
    link: VehicleLink | None
    sights: Mapping[str, float] = field(default_factory=dict)
    uses_motion: bool = False
    log: Path | None = None
    seconds: float | None = None


class Evidence:
    """Collects what came during a check.

    The safety layer's rules are asked of scans and of poses alone, too: in a flight the first broken rule hides others.

    Args:
        setup: what is to be flown.
        flight: the one into nothing.
        health: told of each cycle.

    Attributes:
        cycles: of the flight.
        statuses: of the vehicle, one for each cycle.
        scan_rules: the safety layer's record of each cycle, by its rules of scans.
        pose_rules: the same by its rules of poses and the fence.
        warnings: logged meanwhile, with the name of their logger.
        clock: this computer's time of day at the zero of the loop's clock, s since 1970.
        clock_step: by how much that has changed, s.
    """

    def __init__(self, setup: Setup, flight: Flight, health: FlightHealth) -> None:
        self.setup, self.flight, self.health = setup, flight, health
        self.cycles: list[FlightCycle] = []
        self.statuses: list[VehicleStatus] = []
        self.scan_rules: list[SafetyStatus] = []
        self.pose_rules: list[SafetyStatus] = []
        self.warnings: list[tuple[str, str]] = []
        self.clock_step = 0.0
        self._first_clock: float | None = None
        self._scans, self._poses, self._check = SafetyLayer(setup.limits), SafetyLayer(setup.limits), PoseCheck()
        self._middle = (0.0, 0.0, (setup.limits.floor + setup.limits.ceiling) / 2)
        if setup.limits.box is not None:
            x, y, far_x, far_y = setup.limits.box
            self._middle = ((x + far_x) / 2, (y + far_y) / 2, self._middle[2])
        self.clock = 0.0

    def add(self, cycle: FlightCycle, heard: VehicleStatus, clock: float) -> None:
        """Take in a cycle.

        Args:
            cycle: of the flight into nothing.
            heard: what the vehicle says of itself.
            clock: this computer's time of day at the zero of the loop's clock, s since 1970.
        """
        self.cycles.append(cycle)
        self.statuses.append(heard)
        self.health.sentences(replace(cycle, control=heard))
        self._first_clock = clock if self._first_clock is None else self._first_clock
        self.clock, self.clock_step = clock, max(self.clock_step, abs(clock - self._first_clock))
        now, doubt, age = cycle.time, self.flight.doubt, cycle.status.scan_age
        why = (Reason(doubt.kind), doubt.sentence) if doubt is not None and doubt.certain else None
        scan = None if age is None else now - age
        self.scan_rules.append(self._scans.step(Cycle(now, ZEROS, scan, now, self._middle, 0.0, True, why)))
        implausible, pose = self._check.look(cycle.pose), cycle.pose
        stamp, position, yaw = (None, None, None) if pose is None else (pose.stamp, pose.position, pose.yaw)
        why = None if implausible is None else implausible[:2]
        self.pose_rules.append(self._poses.step(Cycle(now, ZEROS, now, stamp, position, yaw, True, why)))

    @property
    def scans(self) -> list[FlightCycle]:
        """The cycles that have a scan."""
        return [cycle for cycle in self.cycles if cycle.scan is not None]

    @property
    def poses(self) -> list[Pose]:
        """The poses, each once."""
        found = {cycle.pose.stamp: cycle.pose for cycle in self.cycles if cycle.pose is not None}
        return list(found.values())

    @property
    def seconds(self) -> float:
        """From the first cycle to the last."""
        return self.cycles[-1].time - self.cycles[0].time if self.cycles else 0.0

    def settled(self, began: float | None) -> float:
        """Return the time from which on something is judged that began to come at a time, or not at all."""
        start = self.cycles[0].time if self.cycles else 0.0
        return start + SETTLED if began is None or began - start > UNHEARD else began + SETTLED

    def broken(self, rules: Iterable[SafetyStatus], since: float, reasons: Iterable[Reason]) -> tuple[Level, str]:
        """Return how badly some rules were broken since a time, and the sentence that was told most often of them."""
        judged = [status for status in rules if status.time >= since]
        told = Counter(status.reason for status in judged if status.reason in set(reasons))
        if not told:
            return Level.PASS, ""
        share, (worst, _) = told.total() / len(judged), told.most_common(1)[0]
        sentence = next(status.sentence for status in reversed(judged) if status.reason is worst)
        sentence = sentence.partition(", and zeros were sent")[0]
        return (Level.WARN if share <= SELDOM else Level.FAIL), f"{sentence} ({100 * share:.0f} % of the time)"


class _Warnings(logging.Handler):
    """Keeps the warnings that are logged."""

    def __init__(self, into: list[tuple[str, str]]) -> None:
        super().__init__(logging.WARNING)
        self._into = into

    def emit(self, record: logging.LogRecord) -> None:
        told = record.name, record.getMessage()
        if told not in self._into:
            self._into.append(told)


def observe(
    evidence: Evidence,
    listener: Listener,
    seconds: float = OBSERVED,
    clock: Callable[[], float] = time.monotonic,
    wall: Callable[[], float] = time.time,
) -> None:
    """Fly into nothing for some seconds and collect what comes.

    Args:
        evidence: where it is collected.
        listener: the flight's link.
        seconds: for how long.
        clock: in s, of the loop.
        wall: this computer's time of day, s since 1970.
    """
    handler, begun = _Warnings(evidence.warnings), clock()
    logger = logging.getLogger("uavrl_onboard")
    logger.addHandler(handler)
    try:
        for cycle in fly(evidence.flight, evidence.setup.feed, listener, clock):
            evidence.add(cycle, listener.heard, wall() - clock())
            if cycle.time - begun >= seconds:
                return
    finally:
        logger.removeHandler(handler)
