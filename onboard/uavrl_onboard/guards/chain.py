"""All guards of a flight, in their order: what one guard changes, the next one sees."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.evasion import Evasion
from uavrl_onboard.guards.map import Wayfinder
from uavrl_onboard.guards.protocol import Guard, Situation
from uavrl_onboard.guards.settings import EvasionSettings, GuardSettings, MapSettings, ShieldSettings
from uavrl_onboard.guards.shield import Shields
from uavrl_onboard.perception.motion.occlusion import Returns
from uavrl_onboard.perception.motion.rays import ScanPattern
from uavrl_onboard.perception.motion.sight import MotionSight
from uavrl_onboard.vehicle import VEHICLE, Vehicle


def _map(settings: MapSettings, vehicles: int, vehicle: Vehicle) -> Guard:
    return Wayfinder.of(vehicle, vehicles, settings.sight)


def _evasion(settings: EvasionSettings, vehicles: int, vehicle: Vehicle) -> Guard:
    return Evasion(vehicle)


def _shield(settings: ShieldSettings, vehicles: int, vehicle: Vehicle) -> Guard:
    return Shields(settings.time, settings.lag, settings.margin, nearest=settings.nearest or 0.0, vehicle=vehicle)


GUARDS: Mapping[str, Callable[[Any, int, Vehicle], Guard]] = {"map": _map, "evasion": _evasion, "shield": _shield}
"""What makes each guard, by its name."""
NOTHING = np.zeros((3, 0), np.float32)


class Guards:
    """All guards of N vehicles, in their order.

    With evasion on, motion detection comes first and serves all three: points of moving objects are left out of the map
    and of the shield's bounds, because evasion handles them. Where an object was while it was not known to move, its
    cells leave the map. Without evasion, the map and the shield treat moving objects as obstacles that stand.

    Args:
        settings: which guards are on.
        vehicles: N.
        vehicle: its hull, LiDAR, limits, control rate and flight level.

    Raises:
        UavrlError: when called, for velocities, attitudes or altitudes that are not finite: evasion and the shield
            cannot work without them.

    Examples:
        An obstacle stands 1 m ahead of the hull: the shield slows the approach. Evasion ignores what stands.

        >>> seen = Situation(np.array([[[1.35, 0.0, -0.1]]]), np.zeros((1, 3)), np.zeros((1, 3)), np.full(1, 3.5),
        ...     np.zeros(1))
        >>> guards = Guards(GuardSettings.all())
        >>> guards.lead(seen).shape
        (1,)
        >>> guards.filter(np.array([[2.0, 0.0, 0.0]])).round(2) + 0.0
        array([[1.26, 0.  , 0.  ]])
    """

    def __init__(self, settings: GuardSettings, vehicles: int = 1, vehicle: Vehicle = VEHICLE) -> None:
        self.settings, self.vehicles, self.vehicle = settings, vehicles, vehicle
        self.guards = {name: GUARDS[name](getattr(settings, name), vehicles, vehicle) for name in settings.names}
        self._sight: MotionSight | None = None
        if settings.evasion is not None:
            import scipy.spatial  # noqa: F401 - now, and not in flight with the first body that moves

            self._pattern = ScanPattern(*vehicle.lidar_elevations, repeats=vehicle.lidar_repeats)
            seen = settings.evasion
            self._sight = MotionSight(vehicles, seen.sight, seen.objects, vehicle.period, self._pattern)
        self._seen: Situation | None = None

    def reset(self, which: np.ndarray | None = None, *, keep_map: bool = False) -> None:
        """Forget what some vehicles have seen, ``bool [N]``, or all; ``keep_map`` leaves the map as it is."""
        which = np.ones(self.vehicles, bool) if which is None else which
        for name, guard in self.guards.items():
            if name != "map" or not keep_map:
                guard.reset(which)
        if self._sight is not None:
            self._sight.reset(which)

    def lead(self, seen: Situation) -> np.ndarray:
        """Take in new scans; return the angles ``[N]`` in rad that are added to the headings to the goals."""
        self._require_finite(seen)
        before, self._seen = self._seen, seen
        if before is not None and seen.which is not None:
            for one in np.flatnonzero(~seen.which).tolist():
                seen.keep(before, one)
        if self._sight is not None and self.vehicles:
            self._detect_motion(self._sight, seen, before)
        turns = np.zeros(self.vehicles)
        for guard in self.guards.values():
            if (turned := guard.lead(seen)) is not None:
                turns = turns + turned
        return turns

    def filter(self, velocities: np.ndarray) -> np.ndarray:
        """Return the velocities ``[N, 3]`` to fly instead of those that the policy asks for after the last scans.

        Args:
            velocities: forward, left and up in m/s, in the axes of the yaw, as those that are returned.
        """
        if self._seen is None:
            raise UavrlError("Guards filter velocities only after a scan: call lead first.")
        for guard in self.guards.values():
            velocities = guard.filter(velocities, self._seen)
        return velocities

    def _require_finite(self, seen: Situation) -> None:
        """Refuse states without which evasion and the shield would let everything pass."""
        state = (seen.velocities, seen.attitudes, seen.altitudes)
        if set(self.guards) - {"map"} and not all(np.isfinite(each).all() for each in state):
            names = " and ".join(name for name in self.guards if name != "map")
            raise UavrlError(
                f"Guards ({names}) need finite numbers, got velocities of {seen.velocities} m/s, attitudes of "
                f"{seen.attitudes} rad and altitudes of {seen.altitudes} m."
            )

    def _detect_motion(self, sight: MotionSight, seen: Situation, before: Situation | None) -> None:
        """Write into ``seen`` what moves; vehicles without a new scan keep what they saw before."""
        which = np.ones(self.vehicles, bool) if seen.which is None else seen.which
        scans = (seen.columns(one) if which[one] else None for one in range(self.vehicles))
        points = [NOTHING if scan is None else scan.points.take(self._pattern.searched(scan), axis=1) for scan in scans]
        owners = np.repeat(np.arange(self.vehicles), [each.shape[1] for each in points])
        returns = Returns.of_points(np.concatenate(points, 1), owners, sight.max_range)
        seen.objects = sight.look_at(returns, seen.velocities, seen.attitudes, which, seen.elapsed)
        for one in range(self.vehicles):
            if which[one]:
                seen.bodies[one] = sight.bodies[one]
                seen.moving[one] = sight.of_bodies(seen.columns(one), one)
            elif before is not None:
                seen.objects[one] = before.objects[one]
