"""Which numbers environments take, the largest world that is built, and the largest vehicle that fits into it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

from uavrl.errors import UavrlError

if TYPE_CHECKING:
    from uavrl.envs.quadrotor import Airframe
    from uavrl.envs.world import WorldConfig

LARGEST_VALLEY = 200_000.0  # m³ up to the ceiling: building it takes 2.4 GB, and some 20 s
LARGEST_WORLD = 500_000.0  # m³ of all valleys together
MOST_OBSTACLES = 2000.0  # of a valley, each counted by its surface at scale 1
LARGEST = {
    "ceiling": 100.0,
    "goal_radius": 100.0,
    "min_clearance": 100.0,
    "uav_radius": 10.0,
    "planes": 100,
    "plane_speed": 100.0,
    "plane_wingspan": 20.0,
}


def in_turn(counts: Iterable[int] | int) -> tuple[int, ...]:
    """The numbers that valleys take in turn, of which there may be one."""
    return (counts,) if isinstance(counts, int) else tuple(counts)


def check_world_size(world: WorldConfig) -> None:
    """Refuses worlds that would take many minutes to build, or more memory than there is."""
    for name, most in LARGEST.items():
        value = getattr(world, name)
        if (max(value) if isinstance(value, tuple) else value) > most:
            raise UavrlError(f"{name} must be at most {most:g}, got {value}; lower it.")
    valley = world.size[0] * world.size[1] * max(world.ceiling, 1.0)
    for volume, most, of in (
        (valley, LARGEST_VALLEY, "a valley"),
        (valley * len(world.seeds), LARGEST_WORLD, f"{len(world.seeds)} valleys together"),
    ):
        if volume > most:
            raise UavrlError(
                f"size and ceiling must make at most {most:,.0f} m³ of {of}, got {volume:,.0f} m³; lower size or "
                "ceiling, or give fewer seeds."
            )
    obstacles = max(in_turn(world.obstacles)) * max(1.0, world.obstacle_scale**2)
    if obstacles > MOST_OBSTACLES:
        raise UavrlError(
            f"obstacles must be at most {MOST_OBSTACLES:,.0f} in a valley, each counted obstacle_scale² times, got "
            f"{obstacles:,.0f}; lower obstacles or obstacle_scale."
        )


def check_hull(airframe: Airframe, world: WorldConfig) -> None:
    """Refuses vehicles that touch something wherever they start."""
    reach = max(airframe.collision_radius, airframe.collision_height / 2)
    if reach > max(world.min_clearance, world.uav_radius):
        raise UavrlError(
            f"airframe.collision_radius and half of airframe.collision_height must be at most world.min_clearance, "
            f"{world.min_clearance} m, which starts keep from geometry, got {reach} m; lower them or raise that."
        )


def whole(name: str, value: Any, least: int = 0) -> int:
    """The value as an ``int``, NumPy's whole numbers too.

    Raises:
        UavrlError: when it is no whole number, or less than ``least``.

    Examples:
        >>> import numpy as np
        >>> whole("seed", np.int64(3))
        3
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise UavrlError(f"{name} must be a whole number, {least} or more, got {value!r}.")
    return int(value)


def require_finite(config: object, names: Iterable[str]) -> None:
    """Refuses a configuration whose attributes, numbers or lists of such, hold anything but finite numbers."""
    for name in names:
        value = getattr(config, name)
        several = isinstance(value, Iterable) and not isinstance(value, str)
        if not all(isinstance(number, Real) and math.isfinite(number) for number in (value if several else (value,))):
            raise UavrlError(f"{name} must be {'finite numbers' if several else 'a finite number'}, got {value!r}.")
