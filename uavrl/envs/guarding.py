"""Guards around a simulated vehicle: they know its hull and limits, and what its LiDAR sees."""

import logging
import math
from dataclasses import replace

import numpy as np

from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.sensors import LidarSensor
from uavrl.errors import UavrlError
from uavrl.transforms.guarded import Guarded
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.lidar.mount import TILTED, UPRIGHT, mount_tilt

_SECTORS = 12  # of the horizon, whose lowest and highest rays are compared
_SCANS = 5  # of a pattern that changes

log = logging.getLogger(__name__)


def far_seeing(lidar: LidarConfig, *sights: float | None) -> LidarConfig:
    """Return the LiDAR with a ``far_range`` that covers all sights, in m; a ``far_range`` that it has stays.

    Examples:
        >>> far_seeing(LidarConfig(max_range=4.0), None, 12.0).far_range
        12.0
    """
    farthest = max((sight for sight in sights if sight is not None), default=None)
    return replace(lidar, far_range=farthest) if lidar.far_range is None else lidar


def looks_around(device: LidarSensor) -> bool:
    """Return whether a sensor sees the same elevations on all sides, as the detection of what moves needs it.

    Examples:
        >>> from dataclasses import replace
        >>> from uavrl.envs.sensors import SENSORS
        >>> looks_around(SENSORS["rplidar"]), looks_around(SENSORS["d435"])
        (True, False)
        >>> looks_around(replace(SENSORS["mid360"], mount=(180, 0, 0)))  # upside down
        True
        >>> looks_around(replace(SENSORS["mid360"], mount=(0, 20, 0)))  # tilted forward
        False
    """
    level = replace(device, mount=UPRIGHT)
    if mount_tilt(device.mount) > TILTED or level.field_of_view[:2] != (-180.0, 180.0):
        return False
    x, y, z = level.rays.directions[:_SCANS].reshape(-1, 3).astype(float).T
    sector = np.floor(np.arctan2(y, x) / (math.tau / _SECTORS)).astype(int) % _SECTORS
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    lowest, highest = np.full(_SECTORS, np.inf), np.full(_SECTORS, -np.inf)
    np.minimum.at(lowest, sector, elevation)
    np.maximum.at(highest, sector, elevation)
    seen = highest >= lowest
    return bool(max(np.ptp(lowest[seen]), np.ptp(highest[seen])) <= 2 * TILTED)


def guarded(base: NavigationEnv, guards: GuardSettings, max_speed: float | None = None) -> Guarded:
    """Return the transform that puts guards around an environment.

    Args:
        base: with the vehicle and the LiDAR that the guards assume.
        guards: which are on. A shield's ``nearest`` of None becomes the LiDAR's.
        max_speed: the policy's own limit in m/s, which guards keep, too; None for that of the environment.

    Raises:
        UavrlError: if a guard looks farther than the LiDAR reaches: what is not scanned would seem to be free.

    Examples:
        >>> from uavrl_onboard.guards.settings import guard_settings
        >>> base = NavigationEnv(1, lidar=LidarConfig(max_range=4.0, min_range=0.9))
        >>> guarded(base, guard_settings("shield")).guards.shield.nearest
        0.9
    """
    lidar = base.lidar_config
    device = lidar.device
    sights = {name: guard.sight for name in ("map", "evasion") if (guard := getattr(guards, name)) is not None}
    too_far = {name: sight for name, sight in sights.items() if sight > lidar.farthest}
    reach = math.floor(100 * lidar.farthest) / 100
    lower = [f"guards.{name}.sight={reach:g}" for name in too_far]
    if guards.evasion is not None and not looks_around(device):
        others = [name for name in guards.names if name != "evasion"]
        lower = [f"guards=[{','.join(others)}]", *(each for each in lower if "evasion" not in each)]
        log.warning(
            "The LiDAR %s does not see the same elevations on all sides, so static obstacles seem to move when it "
            "turns: leave evasion out (%s).",
            device.name,
            " ".join(lower),
        )
    if too_far:
        found = " and ".join(f"guards.{name}.sight={sight:g}" for name, sight in too_far.items())
        raise UavrlError(
            f"{found} {'look' if len(too_far) > 1 else 'looks'} farther than the LiDAR, which reaches "
            f"{lidar.farthest:g} m: write {' '.join(lower)}, raise the LiDAR's far_range, or choose another LiDAR."
        )
    if guards.shield is not None and guards.shield.nearest is None:
        guards = replace(guards, shield=replace(guards.shield, nearest=lidar.nearest))
    limit = base.max_speed if max_speed is None else min(max_speed, base.max_speed)
    vehicle = base.airframe.vehicle(base.world_config.flight_level, limit)
    vehicle = replace(vehicle, lidar_elevations=device.field_of_view[2:], lidar_repeats=device.repeats)
    return Guarded(guards, vehicle=vehicle)
