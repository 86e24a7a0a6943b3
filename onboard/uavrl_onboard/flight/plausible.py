"""Whether poses are such as a vehicle can have: not only fresh and finite, but reached by flying."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.flight.safety import Reason

JUMP = 0.5
"""Distance that estimators correct a position by without a reset, m."""
UNTOLD = 2.0
"""Speed by which the velocity may be wrong, m/s: that of the policies, as some drivers tell none."""
FASTEST = 20.0
"""Greatest speed of a vehicle, m/s, whatever its velocity says."""
FARTHEST = 100_000.0
"""Distance from the autopilot's origin that no vehicle flies, m: a position is told to 8 mm there, and worse beyond."""
YAW_JUMP, TURN = 0.5, 4.0
"""Yaw that a compass corrects at once, rad, and the greatest yaw rate, rad/s: PX4's is 3.5 by default."""
DISAGREEMENT = 1.0
"""Distance in a second by which position and velocity may differ, m: estimates of velocity are good to 0.3 m/s."""
DOUBTED = 5.0
"""Time for which a pose is doubted after that, s: while the vehicle stands, both agree again."""
_WINDOW = 1.0  # s over which they are compared
_FEWEST = 5  # poses of that time
_GAP = 0.3  # s between two poses across which nothing is compared


class Implausible(NamedTuple):
    """Why a pose or a scan is not believed."""

    reason: Reason
    sentence: str
    starts_anew: bool = False  #: whether what was remembered lies in other axes than what is seen now


class PoseCheck:
    """Compares each pose with those before it.

    Examples:
        >>> check, still = PoseCheck(), (0.0, 0.0, 0.0)
        >>> check.look(Pose(0.0, (0.0, 0.0, 3.0), still, 0.0))
        >>> check.look(Pose(0.1, (20.0, 0.0, 3.0), still, 0.0)).sentence
        'the position jumped by 20.0 m in 0.10 s, and the vehicle flies at most 0.7 m in that time'
    """

    def __init__(self) -> None:
        self._before: Pose | None = None
        self._track: deque[tuple[float, np.ndarray, np.ndarray]] = deque()  # stamps, positions, velocities
        self._disagreed: tuple[float, str] | None = None

    def look(self, pose: Pose | None) -> Implausible | None:
        """Return what is wrong with a pose; poses that are no newer, or not finite, are not compared."""
        if pose is None or not np.isfinite([pose.stamp, *pose.position, pose.yaw]).all():
            return None
        far = math.hypot(*pose.position)
        if far > FARTHEST:
            self._before = None
            self._track.clear()
            where = f"the position is {far:.2g} m from the autopilot's origin, and no vehicle flies so far"
            return Implausible(Reason.POSITION_FAR, f"{where}: look at its estimator", True)
        before = self._before
        if before is None or pose.stamp > before.stamp:
            self._before = pose
            if before is not None and (jump := _jump(before, pose)) is not None:
                self._track.clear()
                return jump
            self._compare(pose)
        if self._disagreed is None or pose.stamp - self._disagreed[0] > DOUBTED:
            return None
        return Implausible(Reason.VELOCITY_DISAGREES, self._disagreed[1])

    def _compare(self, pose: Pose) -> None:
        """Compare the distance of the latest second with the velocities told in it."""
        if not np.isfinite(pose.velocity).all() or (self._track and pose.stamp - self._track[-1][0] > _GAP):
            self._track.clear()
            return
        self._track.append((pose.stamp, np.array(pose.position), np.array(pose.velocity)))
        while len(self._track) > 1 and pose.stamp - self._track[1][0] >= _WINDOW:
            self._track.popleft()
        stamps, positions, velocities = (np.array(each) for each in zip(*self._track, strict=True))
        span = stamps[-1] - stamps[0]
        if len(stamps) < _FEWEST or span < _WINDOW:
            return
        told = (np.diff(stamps)[:, None] * (velocities[1:] + velocities[:-1]) / 2).sum(0)
        flown = positions[-1] - positions[0]
        if np.linalg.norm(flown - told) > DISAGREEMENT * span:
            rates = f"{np.linalg.norm(flown) / span:.1f} m/s, and the velocity says {np.linalg.norm(told) / span:.1f}"
            look = "look whether its sender fills the velocity in, and in the axes of the message"
            self._disagreed = pose.stamp, f"the position moves by {rates} m/s, or another way: {look}"


def _jump(before: Pose, pose: Pose) -> Implausible | None:
    elapsed = pose.stamp - before.stamp
    far = math.dist(before.position, pose.position)
    speeds = [math.hypot(*each.velocity) for each in (before, pose)]
    fastest = max(speeds) if np.isfinite(speeds).all() else FASTEST
    reach = JUMP + elapsed * (min(fastest, FASTEST) + UNTOLD)
    turned = abs(math.remainder(pose.yaw - before.yaw, math.tau))
    turns = YAW_JUMP + elapsed * TURN
    reset = pose.resets != before.resets
    told = ", as the autopilot's estimator was reset" if reset else ""
    if far > reach:
        most = f"and the vehicle flies at most {reach:.1f} m in that time"
        sentence = f"the position jumped by {far:.1f} m in {elapsed:.2f} s{told}, {most}"
        return Implausible(Reason.POSITION_JUMPED, sentence, True)
    if turned > turns:
        most = f"and the vehicle turns by at most {math.degrees(turns):.0f}° in that time"
        sentence = f"the yaw jumped by {math.degrees(turned):.0f}° in {elapsed:.2f} s{told}, {most}"
        return Implausible(Reason.YAW_JUMPED, sentence, True)
    if reset:
        moved = f"the pose moved by {far:.1f} m and {math.degrees(turned):.0f}° in {elapsed:.2f} s"
        return Implausible(Reason.POSE_RESET, f"the autopilot's estimator was reset: {moved}", True)
    return None
