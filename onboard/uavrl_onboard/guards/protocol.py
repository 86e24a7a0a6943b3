"""What a guard is: a filter between what a policy asks for and what is flown.

There are three. The map turns the heading that the policy reads, evasion exchanges velocities that would meet a moving
object, and the shield limits the speed near obstacles. :class:`~uavrl_onboard.guards.chain.Guards` joins them in the
order of :class:`~uavrl_onboard.guards.settings.GuardSettings`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from uavrl_onboard.geometry import Columns


@dataclass
class Situation:
    """The latest scans of N vehicles, and the state of these vehicles.

    Args:
        clouds: Scans, ``[N, P, 3]`` in m in the sensor frame; NaN, infinity and zeros where a ray hit nothing.
        velocities: Velocities of the vehicles, ``[N, 3]`` in m/s in world axes.
        attitudes: Their roll, pitch and yaw, ``[N, 3]`` in rad.
        altitudes: Their altitudes, ``[N]`` in m.
        headings: Angles from the vehicles' heads to their goals, ``[N]`` in rad, left positive.
        elapsed: Time since the scans before, in s; None for the vehicle's period.
        places: Where the vehicles are, ``[N, 3]`` in m in world axes; None where this is unknown.
        goals: Where their goals are, ``[N, 2]`` in m in the same axes; None where this is unknown.
        which: Which vehicles have a new scan, ``bool [N]``; None for all.

    Attributes:
        objects: The nearest moving objects, ``float32 [N, K, 7]`` as
            ``MotionSight`` reports them.
        moving: Of each vehicle, which returns of its scan belong to moving objects, ``bool [M]``; None for no return.
        bodies: Of each vehicle, all moving objects, ``[M, 7]``.
    """

    clouds: np.ndarray
    velocities: np.ndarray
    attitudes: np.ndarray
    altitudes: np.ndarray
    headings: np.ndarray
    elapsed: float | None = None
    places: np.ndarray | None = None
    goals: np.ndarray | None = None
    which: np.ndarray | None = None
    objects: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 7), np.float32))
    moving: list[np.ndarray | None] = field(default_factory=list)
    bodies: list[np.ndarray] = field(default_factory=list)
    _columns: dict[int, Columns] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Begin with nothing that moves."""
        if not self.moving:
            self.moving = [None] * len(self.clouds)
            self.bodies = [np.zeros((0, 7), np.float32)] * len(self.clouds)

    def columns(self, vehicle: int) -> Columns:
        """Return the returns of one vehicle's scan; guards look at different parts of them."""
        if vehicle not in self._columns:
            self._columns[vehicle] = Columns.of(self.clouds[vehicle])
        return self._columns[vehicle]

    def take_returns(self, vehicle: int, columns: Columns) -> None:
        """Take the returns of one vehicle's scan, where they are known already."""
        self._columns[vehicle] = columns

    def keep(self, before: Situation, vehicle: int) -> None:
        """Take over the last scan of a vehicle that has no new one, and what moves in it."""
        self.bodies[vehicle], self.moving[vehicle] = before.bodies[vehicle], before.moving[vehicle]
        self._columns[vehicle] = before.columns(vehicle)

    def standing(self, vehicle: int, farthest: float) -> np.ndarray:
        """Return the returns of one vehicle nearer than ``farthest`` metres, without moving objects, ``[K, 3]``."""
        moving, columns = self.moving[vehicle], self.columns(vehicle)
        kept = columns.within(farthest)
        return columns.rows(kept if moving is None else kept[~moving.take(kept)])


class Guard(Protocol):
    """A filter for N vehicles."""

    def reset(self, which: np.ndarray) -> None:
        """Forget what some vehicles have seen, ``bool [N]``."""

    def lead(self, seen: Situation) -> np.ndarray | None:
        """Take in new scans; return the angles ``[N]`` in rad that are added to the headings, or None for none."""

    def filter(self, velocities: np.ndarray, seen: Situation) -> np.ndarray:
        """Return the velocities ``[N, 3]`` to fly instead, in m/s: forward, left, up."""
