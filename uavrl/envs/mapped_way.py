"""Ways out of dead ends through what the vehicles have scanned, for demonstrators and critics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from uavrl_onboard.geometry import heading_vector
from uavrl_onboard.guards.map.wayfinder import Wayfinder
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.guards.settings import MapSettings
from uavrl_onboard.vehicle import Vehicle

BEGINS, ENDS = 3.0, 0.5  # m of detour above which a way is followed instead of the goal's direction, and until which


class MappedWays:
    """Where all vehicles should head: to the goal, or along a way out of a dead end that their LiDARs have shown.

    The ways are those of the guard ``map``, each through a map of what the vehicle's LiDAR has shown in its episode. So
    they know nothing that a policy could not remember. It sees as far as the LiDAR reports points, at most 12 m.

    A way is followed once it counts 3 m more than one in free air, and until it counts 0.5 m more. Smaller detours are
    left to the vehicle, which flies around single obstacles anyway: a policy can imitate that from what it sees, and
    which side the map prefers it cannot see.

    Args:
        vehicles: How many there are.
        vehicle: Their LiDAR's position, control rate and flight level.
        reach: How far the LiDAR reports points, in m.
    """

    def __init__(self, vehicles: int, vehicle: Vehicle, reach: float) -> None:
        self._finder = Wayfinder.of(vehicle, vehicles, min(reach, MapSettings().sight))
        self._ways = np.zeros((vehicles, 2))
        self._followed = np.zeros(vehicles, bool)

    def begin(self, which: np.ndarray) -> None:
        """Forget what some vehicles have seen, ``bool [N]``: their episodes begin."""
        self._finder.reset(which)
        self._followed[which] = False

    def directions(self, told: Mapping[str, np.ndarray], which: np.ndarray) -> np.ndarray:
        """Take in the scans of some vehicles; return unit vectors ``[N, 2]``, forward and left: where they should head.

        Those of the other vehicles stay as they were.

        Args:
            told: What all vehicles emit: ``point_cloud``, ``velocity``, ``attitude``, ``altitude`` and ``heading_deg``.
            which: ``bool [N]``, the vehicles with a new scan.
        """
        headings = np.deg2rad(told["heading_deg"])
        state = told["velocity"], told["attitude"], told["altitude"], headings
        turns, detours = self._finder.lead(Situation(told["point_cloud"], *state, which=which)), self._finder.detours
        self._followed = (self._followed | (detours > BEGINS)) & (detours > ENDS)
        self._ways[which] = heading_vector(headings + np.where(self._followed, turns, 0.0))[which]
        return self._ways
