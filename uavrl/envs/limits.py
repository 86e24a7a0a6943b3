"""Which numbers environments take."""

import math
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

from uavrl.errors import UavrlError


def check_hull(radius: float, height: float, clearance: float) -> None:
    """Refuses vehicles that touch something wherever they start: a hull that reaches farther than starts keep off."""
    reach = max(radius, height / 2)
    if reach > clearance:
        raise UavrlError(
            f"airframe.collision_radius and half of airframe.collision_height must be at most world.min_clearance, "
            f"{clearance} m, which starts keep from geometry, got {reach} m; lower them or raise that."
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
