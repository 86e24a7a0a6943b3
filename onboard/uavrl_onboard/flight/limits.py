"""How far a set-point may go: clipped, changed no faster than a limit, and not out of a fence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import world_to_yaw, yaw_to_world
from uavrl_onboard.vehicle import VEHICLE

SIDES = ("floor", "ceiling", "wall")
LONGEST = {"scan_age": 1.0, "pose_age": 1.0, "hold": 10.0}
"""Greatest limits, s: a vehicle at 2 m/s is 2 m farther than a scan says that is a second old."""
_ROUNDING = 1e-6  # m/s or rad/s: a change that is not mentioned


@dataclass(frozen=True)
class SafetyLimits:
    """What the safety layer lets pass, and for how long it waits.

    Args:
        velocity: Greatest forward, left and up velocity each, m/s.
        yaw_rate: Greatest yaw rate, rad/s.
        acceleration: Greatest change of each velocity from one cycle to the next, m/s².
        yaw_acceleration: That of the yaw rate, rad/s².
        scan_age: Greatest age of a scan, counted from its last packet, and the longest time between two cycles, s.
        pose_age: Greatest age of the position or the yaw, whichever is older, s.
        hold: For how long zeros are sent before nothing is, s.
        recovery: For how long all rules must hold before the policy flies again, s.
        return_after_silence: For how long they must hold before anything is sent again, s.
        floor: Lowest altitude, m.
        ceiling: Highest altitude, m.
        box: Least x, least y, greatest x, greatest y in the world's axes, m; ``None`` for a fence without walls.
        margin: How far outside the fence the vehicle may drift before the policy is stopped, m.
        fence_time: The velocity towards a side of the fence is at most the distance to it in this time, s.
    """

    velocity: float = VEHICLE.velocity_limit
    yaw_rate: float = VEHICLE.yaw_rate_limit
    acceleration: float = 20.0
    yaw_acceleration: float = 20.0
    scan_age: float = 0.2
    pose_age: float = 0.1
    hold: float = 0.5
    recovery: float = 0.3
    return_after_silence: float = 1.0
    floor: float = 1.0
    ceiling: float = 5.0
    box: tuple[float, float, float, float] | None = None
    margin: float = 0.5
    fence_time: float = 1.0

    def __post_init__(self) -> None:
        for name in [field.name for field in fields(self) if field.name not in ("floor", "ceiling", "box")]:
            value = getattr(self, name)
            if not (isinstance(value, int | float) and 0.0 < value < math.inf):
                raise UavrlError(f"{name} must be a finite number above 0, got {value!r}.")
        for name, longest in LONGEST.items():
            if (value := getattr(self, name)) > longest:
                raise UavrlError(f"{name} must be at most {longest:g} s, got {value:g} s: limits are in seconds.")
        if self.box is not None and len(self.box) != 4:
            raise UavrlError(f"box must be four numbers (x_min, y_min, x_max, y_max) in metres, got {self.box!r}.")
        low, high = self.corners
        if not (low < high).all():
            raise UavrlError(
                f"The fence has no inside: floor {self.floor:g} must be below ceiling {self.ceiling:g}"
                + (f", and in box {self.box} x_min below x_max and y_min below y_max." if self.box else ".")
            )

    @property
    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """The fence's corners with the least and with the greatest coordinates."""
        x_min, y_min, x_max, y_max = self.box or (-math.inf, -math.inf, math.inf, math.inf)
        return np.array([x_min, y_min, self.floor], float), np.array([x_max, y_max, self.ceiling], float)


def outside_fence(goal: Sequence[float], limits: SafetyLimits) -> str | None:
    """Say how far a goal lies outside the fence, where no vehicle is flown; None inside.

    Examples:
        >>> outside_fence((20.0, 0.0, 7.0), SafetyLimits())
        "The goal (20, 0, 7) lies 2.0 m outside the fence's ceiling: see goal= and safety.ceiling="
    """
    outside, side = distance_outside(np.array(goal, float), limits)
    if outside <= 0.0:
        return None
    place = ", ".join(f"{each:g}" for each in goal)
    key = f"safety.{'box' if side == 'wall' else side}="
    return f"The goal ({place}) lies {outside:.1f} m outside the fence's {side}: see goal= and {key}"


class Limited(NamedTuple):
    """A set-point within the limits, and what it cost."""

    setpoint: np.ndarray  #: ``[4]``
    by: tuple[str, ...]  #: which of ``clip``, ``slew`` and ``fence`` changed the action
    side: str | None  #: of the fence, of ``SIDES``


def distance_outside(position: np.ndarray, limits: SafetyLimits) -> tuple[float, str]:
    """How far a position is outside the fence, m, at most 0 inside, and at which side.

    Examples:
        >>> distance_outside(np.array([0.0, 0.0, 0.25]), SafetyLimits())
        (0.75, 'floor')
    """
    low, high = limits.corners
    below, above = low - position, position - high
    ways = float(below[2]), float(above[2]), float(max(below[:2].max(), above[:2].max()))
    return max(zip(ways, SIDES, strict=True))


def limit(
    action: np.ndarray, previous: np.ndarray, elapsed: float, position: np.ndarray, yaw: float, limits: SafetyLimits
) -> Limited:
    """Brings a finite action within the limits.

    The fence comes last: to stay inside, a velocity may fall faster than the others change.

    Args:
        action: (l_x, l_y, l_z, a_z), forward, left, up and the yaw rate.
        previous: the set-point before it.
        elapsed: since that one, s.
        position: ``[3]`` in the world's axes, m.
        yaw: in the same axes, rad.
        limits: what passes.

    Examples:
        >>> limit(np.array([3.0, 0, 2, 0]), np.zeros(4), 1.0, np.array([0, 0, 4.5]), 0.0, SafetyLimits())
        Limited(setpoint=array([2. , 0. , 0.5, 0. ]), by=('clip', 'fence'), side='ceiling')
    """
    most = np.array([limits.velocity] * 3 + [limits.yaw_rate])
    change = elapsed * np.array([limits.acceleration] * 3 + [limits.yaw_acceleration])
    clipped = np.clip(action, -most, most)
    slewed = np.clip(clipped, previous - change, previous + change)
    slewed = np.clip(slewed, -most, most)  # where the rounding of the line above has passed it
    kept, side = _fenced(slewed, position, yaw, limits)
    steps = {"clip": (action, clipped), "slew": (clipped, slewed), "fence": (slewed, kept)}
    by = tuple(name for name, (was, now) in steps.items() if np.abs(was - now).max() > _ROUNDING)
    return Limited(kept, by, side)


def _fenced(
    setpoint: np.ndarray, position: np.ndarray, yaw: float, limits: SafetyLimits
) -> tuple[np.ndarray, str | None]:
    """Takes from a set-point what leads out of the fence too fast."""
    low, high = limits.corners
    world = yaw_to_world(setpoint[:3], yaw)
    inside = np.clip(
        world,
        -np.maximum(position - low, 0.0) / limits.fence_time,
        np.maximum(high - position, 0.0) / limits.fence_time,
    )
    cut = inside != world
    if not cut.any():
        return setpoint, None
    turned = world_to_yaw(inside[:2], yaw)
    # Without one of the world's components the vector can point more along one of the body's: shorten it, not turn it.
    turned *= min(1.0, limits.velocity / max(np.abs(turned).max(), limits.velocity))
    kept = np.array([*np.clip(turned, -limits.velocity, limits.velocity), inside[2], setpoint[3]])
    return kept, ("floor" if setpoint[2] < 0.0 else "ceiling") if cut[2] else "wall"
