"""One loop from scans to set-points: source, mask, reduction, frames, policy, safety layer, vehicle."""

from __future__ import annotations

import logging
import math
import select
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from uavrl_onboard.autopilot.frames import Pose, to_goal
from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.interfaces import FlightCycle, ScanFeed, VehicleLink
from uavrl_onboard.flight.memory import keep_memory
from uavrl_onboard.flight.plausible import Implausible, PoseCheck
from uavrl_onboard.flight.safety import ZEROS, Cycle, Reason, SafetyLayer, SafetyState
from uavrl_onboard.flight.scan_motion import ScanMotion
from uavrl_onboard.geometry import Columns
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.lidar.coverage import Coverage, Doubt
from uavrl_onboard.lidar.mount import TILTED, rotation_tilt, turned
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.lidar.sources import without_vehicle

if TYPE_CHECKING:
    from uavrl_onboard.policy.policy import Policy

_logger = logging.getLogger(__name__)

_EARLY = 0.8  # of a cycle: a scan that comes sooner after the one before is left out, as of a sensor that turns faster
_LATE = 1.2  # of a cycle: after that it goes on without a scan
_ARRIVING = 3  # cycles in a row at the goal, by plausible poses, after which the vehicle has arrived
_FORGOTTEN = 2.5  # cycles without an action, after which the policy begins anew
_AGAIN = 1.0  # s without a jump of the pose after which the next one is told
_TICK = 0.005  # s between two looks at what the system cannot wait for
_FLIES = (SafetyState.FLYING, SafetyState.FENCED)


class Flight:
    """One vehicle's flight to a goal: policy, guards, safety layer and checks, from a scan and a pose to a set-point.

    While the safety layer does not let the policy fly, each scan is to the policy the first of an episode, so that it
    takes off from where it stands as it has learned to. Its last action is what the vehicle was sent. At the goal the
    vehicle is sent zeros, and once it has been there for three cycles in a row it hovers from there on.

    Poses and scans are checked for being plausible, too (`uavrl_onboard.flight.plausible`,
    `uavrl_onboard.lidar.coverage`, `uavrl_onboard.flight.scan_motion`). Where the pose jumps, policy, map and tracks
    start anew, and an arrival before that does not count.

    Args:
        policy: an exported policy.
        goal: x, y, z in the world's axes, m; z is the middle of its height.
        link: the way to the vehicle.
        layer: the safety layer.
        radius: the vehicle has arrived at this horizontal distance from the goal, m.
        rotation: from the sensor's axes to the vehicle's, ``[3, 3]``; None where they are the same.
        box: the corners of a box around the vehicle, from the sensor in m along the vehicle's axes, whose points are
            left out.
        guards: filters between the policy and the vehicle; None: those of the policy's contract.
        moves: whether the link's pose is that of the sensor; False for a dry run, whose vehicle only stands.

    Attributes:
        arrived: when the vehicle arrived, on the loop's clock; ``None`` before.
        doubt: what is wrong with the latest scans; ``None`` for nothing.
        refusal: why the policy gave no action when it last gave none; "" where it always did.
    """

    def __init__(
        self,
        policy: Policy,
        goal: Sequence[float],
        link: VehicleLink,
        layer: SafetyLayer,
        *,
        radius: float = 1.0,
        rotation: np.ndarray | None = None,
        box: tuple[np.ndarray, np.ndarray] | None = None,
        guards: Guards | None = None,
        moves: bool = True,
    ) -> None:
        if len(goal) != 3 or not np.isfinite(goal).all():
            raise UavrlError(f"goal must be three finite numbers x, y, z in metres, got {goal!r}.")
        keep_memory()
        self.goal = tuple(float(each) for each in goal)
        self.arrived: float | None = None
        self.period = 1.0 / policy.contract.rate_hz
        self._policy, self._link, self._layer = policy, link, layer
        self._radius, self._rotation, self._box = radius, rotation, box
        contract = policy.contract
        self._guards = Guards(contract.guard_settings, 1, contract.vehicle) if guards is None else guards
        lidar = contract.cloud.lidar
        sides = (-180.0, 180.0) if lidar is None else lidar.field_of_view[:2]
        level = rotation is None or rotation_tilt(rotation) <= TILTED
        self._coverage = Coverage(sides, self._guards.vehicle.lidar_elevations, level)
        self._poses, self._motion, self._moves = PoseCheck(), ScanMotion(), moves
        self.doubt: Doubt | None = None
        self._jumped = -math.inf  # stamp of the latest pose that jumped
        self._there = 0  # cycles in a row at the goal
        self._scan_stamp: float | None = None
        self._read_stamp: float | None = None  # of the last scan that the policy has read in this episode
        self._action: np.ndarray | None = None  # of the latest scan, None where that gave none
        self._turn: float | None = None  # of the latest scan, where the map leads
        self._acted = -math.inf  # when the policy last gave one
        self._state = SafetyState.SILENT
        self._control: Control | None = None  # who flew in the cycle before
        self.refusal = ""

    @property
    def disagreement(self) -> str | None:
        """Why scans do not move as the pose says; None where they do, or nobody can tell."""
        return self._motion.sentence

    def wants(self, scan: Scan | None) -> bool:
        """Whether a scan begins a cycle: of a sensor that turns faster than the policy acts, not every one does."""
        if scan is None:
            return False
        since = math.inf if self._scan_stamp is None else scan.stamp - self._scan_stamp
        return not 0.0 <= since < _EARLY * self.period

    def step(self, now: float, scan: Scan | None) -> FlightCycle:
        """One cycle; the set-point is sent before it returns.

        Args:
            now: the loop's clock, s.
            scan: a new one, or ``None`` where none has come in time.
        """
        begun = time.perf_counter()
        pose, control = self._link.pose(), self._link.status(now)
        if control.control is not self._control:
            _logger.info("Vehicle: %s (%s)", control.control, control.sentence)
        self._control = control.control
        if scan is not None and self._rotation is not None:
            scan = replace(scan, points=turned(scan.points, self._rotation))
        returns = None if scan is None else Columns.of(scan.points)
        implausible = self._check(returns, pose)
        if scan is not None and returns is not None:
            if self._box is not None:
                scan = replace(scan, points=without_vehicle(scan.points, *self._box))
                returns = Columns.of(scan.points)
            self._scan_stamp, self._action = scan.stamp, self._act(scan, returns, pose, now)
        distance = self._distance(pose)
        at_goal = distance is not None and distance <= self._radius
        action = np.zeros(4) if at_goal or self.arrived is not None else self._action
        stamp, position, yaw = (None, None, None) if pose is None else (pose.stamp, pose.position, pose.yaw)
        in_control = control.control is Control.IN_CONTROL
        why = None if implausible is None else implausible[:2]
        status = self._layer.step(Cycle(now, action, self._scan_stamp, stamp, position, yaw, in_control, why))
        self._link.send(status.setpoint, now)
        latency = None if scan is None else now - scan.stamp + time.perf_counter() - begun
        if scan is not None and self._moves:  # after the set-point, which does not wait for it
            self._motion.add(scan.points, pose)
        self._policy.last_action = np.array(status.setpoint or ZEROS, np.float32)
        self._state = status.state
        self._there = self._there + 1 if at_goal and status.state in _FLIES else 0
        if self.arrived is None and self._there >= _ARRIVING:
            self.arrived = now
        cells = None if scan is None else self._policy.cells
        arrived, turn = self.arrived is not None, None if scan is None else self._turn
        doubt = None if self.doubt is None or self.doubt.certain else self.doubt.sentence
        return FlightCycle(now, scan, cells, pose, distance, action, control, status, latency, arrived, turn, doubt)

    def _check(self, returns: Columns | None, pose: Pose | None) -> Implausible | None:
        """What is implausible about the pose, or about the latest scans."""
        implausible = self._poses.look(pose)
        if implausible is not None and implausible.starts_anew:
            if pose is not None and pose.stamp - self._jumped > _AGAIN:
                _logger.warning("Pose: %s: the policy starts anew", implausible.sentence)  # whatever else is wrong now
            self._jumped = -math.inf if pose is None else pose.stamp
            self._start_anew()
        if returns is not None:
            self.doubt = self._coverage.look(returns, None if pose is None else pose.yaw)
        if implausible is None and self.doubt is not None and self.doubt.certain:
            return Implausible(Reason(self.doubt.kind), self.doubt.sentence)
        if implausible is None and self.disagreement is not None:
            return Implausible(Reason.SCANS_DISAGREE, self.disagreement)
        return implausible

    def _start_anew(self) -> None:
        """Drops what was remembered in axes that are others now."""
        self.arrived, self._there = None, 0
        self._acted = -math.inf
        self._motion.start_anew()
        self._guards.reset()

    def _act(self, scan: Scan, returns: Columns, pose: Pose | None, now: float) -> np.ndarray | None:
        """The policy's action, or ``None`` where it can give none."""
        if self._state not in _FLIES or now - self._acted > _FORGOTTEN * self.period:
            self._policy.reset()
            self._read_stamp = None
            self._guards.reset(keep_map=True)
        self._turn = None
        if pose is None or not np.isfinite([*pose.position, pose.yaw]).all():
            return None
        read = to_goal(pose, self.goal)
        elapsed = None if self._read_stamp is None or scan.stamp <= self._read_stamp else scan.stamp - self._read_stamp
        try:
            turn = float(self._guards.lead(self._situation(scan, returns, pose, read["heading_deg"], elapsed))[0])
            self._turn = turn if "map" in self._guards.guards else None
            heading = (read["heading_deg"] + math.degrees(turn)) % 360.0
            told = (read["altitude"], heading, read["elevation_deg"], pose.velocity, pose.attitude, elapsed)
            action = self._policy(scan.points, *told)
            action[:3] = self._guards.filter(action[None, :3])[0]
        except UavrlError as error:
            if str(error) != self.refusal:
                _logger.warning("The policy gives no action: %s", error)
            self.refusal = str(error)
            return None
        self._acted, self._read_stamp = now, scan.stamp
        return action

    def _situation(
        self, scan: Scan, returns: Columns, pose: Pose, heading_deg: float, elapsed: float | None
    ) -> Situation:
        """What the guards see."""
        own = np.array([pose.velocity]), np.array([pose.attitude]), np.array([pose.position[2]])
        heading, place, goal = np.radians([heading_deg]), np.array([pose.position]), np.array([self.goal[:2]])
        seen = Situation(scan.points[None], *own, heading, elapsed, place, goal)
        seen.take_returns(0, returns)
        return seen

    def _distance(self, pose: Pose | None) -> float | None:
        """How far the goal is, horizontally, in m."""
        if pose is None:
            return None
        return math.hypot(self.goal[0] - pose.position[0], self.goal[1] - pose.position[1])


def fly(
    flight: Flight, feed: ScanFeed, link: VehicleLink, clock: Callable[[], float] = time.monotonic
) -> Iterator[FlightCycle]:
    """Flies in real time: a cycle with each scan, and one without where none comes in time. It does not end by itself.

    Args:
        flight: of the vehicle, with its policy and its link.
        feed: of scans, stamped on the same clock.
        link: of the flight, to read what the vehicle says.
        clock: in s.
    """
    cycled = clock()
    waits = [number for number in (feed.fileno(), link.fileno()) if number is not None]
    while True:
        rest = max(cycled + _LATE * flight.period - clock(), 0.0)
        select.select(waits, [], [], rest if len(waits) == 2 else min(rest, _TICK))
        link.receive(clock())
        scan = feed.poll(clock())
        scan, now = (scan if flight.wants(scan) else None), clock()
        if scan is not None or now - cycled >= _LATE * flight.period:
            cycled = now
            yield flight.step(now, scan)


def rehearse(flight: Flight, scans: Iterable[Scan], link: VehicleLink) -> Iterator[FlightCycle]:
    """Flies a recording: a cycle with each scan, whose stamps are the clock."""
    for scan in scans:
        if flight.wants(scan):
            link.receive(scan.stamp)
            yield flight.step(scan.stamp, scan)
