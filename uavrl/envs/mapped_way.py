"""The quickest ways to the goals through what the vehicles have scanned, for demonstrators and critics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from uavrl_onboard.geometry import heading_vector
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.guards.settings import GuardSettings, MapSettings
from uavrl_onboard.vehicle import Vehicle


class MappedWays:
    """The quickest ways of all vehicles, each through a map of what its LiDAR has shown in its episode.

    It is the guard ``map``, which turns no heading here: it knows nothing that a policy could not remember. It sees as
    far as the LiDAR reports points, at most 12 m.

    Args:
        vehicles: How many there are.
        vehicle: Their LiDAR's position, control rate and flight level.
        reach: How far the LiDAR reports points, in m.
    """

    def __init__(self, vehicles: int, vehicle: Vehicle, reach: float) -> None:
        sight = min(reach, MapSettings().sight)
        self._guards = Guards(GuardSettings(map=MapSettings(sight)), vehicles, vehicle)
        self._ways = np.zeros((vehicles, 2))

    def begin(self, which: np.ndarray) -> None:
        """Forget what some vehicles have seen, ``bool [N]``: their episodes begin."""
        self._guards.reset(which)

    def directions(self, told: Mapping[str, np.ndarray], which: np.ndarray) -> np.ndarray:
        """Take in the scans of some vehicles; return unit vectors ``[N, 2]``, forward and left, along the ways.

        Those of the other vehicles stay as they were.

        Args:
            told: What all vehicles emit: ``point_cloud``, ``velocity``, ``attitude``, ``altitude`` and ``heading_deg``.
            which: ``bool [N]``, the vehicles with a new scan.
        """
        headings = np.deg2rad(told["heading_deg"])
        state = told["velocity"], told["attitude"], told["altitude"], headings
        turned = headings + self._guards.lead(Situation(told["point_cloud"], *state, which=which))
        self._ways[which] = heading_vector(turned)[which]
        return self._ways
