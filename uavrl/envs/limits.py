"""The numbers and settings that environments take."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from numbers import Integral, Real
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import numpy as np
from pydantic import Field

from uavrl.errors import UavrlError, did_you_mean

T = TypeVar("T")
FASTEST = 10.0  # m/s: at the tilt limit drag holds the default airframe there
MaxSpeed = Annotated[float, Field(gt=0, le=FASTEST)]

if TYPE_CHECKING:
    OrMapping: TypeAlias = T | Mapping[str, Any]
else:

    class OrMapping:
        """``OrMapping[WorldConfig]``: a configuration, or a dict of its settings.

        At run time it is the configuration's class alone, which is what a yaml file is validated against.
        """

        def __class_getitem__(cls, kind: type) -> type:
            """Return the class itself."""
            return kind


def settings(name: str, kind: type[T], given: OrMapping[T] | None) -> T:
    """Return the configuration that an argument means: an object of its class, a dict of its settings, or None.

    Args:
        name: of the argument, for the error message.
        kind: class of the configuration, a dataclass.
        given: the argument; None means the defaults.

    Raises:
        UavrlError: if a key is no setting of this class, or ``given`` is something else.
        ValueError: if the class refuses a value.

    Examples:
        >>> from uavrl.envs.world import WorldConfig
        >>> settings("world", WorldConfig, {"planes": 3}).planes
        3
    """
    if given is None:
        return kind()
    if isinstance(given, kind):
        return given
    if not isinstance(given, Mapping):
        raise UavrlError(f"{name} takes a {kind.__name__} or a dict of its settings, got {given!r}.")
    known = [each.name for each in fields(kind)]  # type: ignore[arg-type]
    for key in given:
        if key not in known:
            hint = did_you_mean(str(key), known, ": ", f"it takes {', '.join(known)}.")
            raise UavrlError(f"{name} has no setting {key!r}{hint}")
    return kind(**given)


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


def require_speed(speed: float) -> float:
    """Return the limit of each component of a velocity in m/s, or refuse it.

    Examples:
        >>> require_speed(4)
        4.0
    """
    if not isinstance(speed, Real) or isinstance(speed, bool) or not 0 < speed <= FASTEST:
        raise UavrlError(f"max_speed must be above 0 and at most {FASTEST:g} m/s, got {speed!r}.")
    return float(speed)


def require_finite(config: object, names: Iterable[str]) -> None:
    """Refuse a configuration unless its tuple fields hold lists of finite numbers, and its other fields finite numbers.

    NumPy's numbers become Python's and lists become tuples, so that two equal configurations compare as equal, and a
    configuration can be written as JSON.
    """
    known = {each.name: each for each in fields(config)}  # type: ignore[arg-type]
    for name in names:
        value = getattr(config, name)
        several = isinstance(known[name].default, tuple) or "tuple" in str(known[name].type).lower()
        numbers = value if several and isinstance(value, Iterable) and not isinstance(value, str) else (value,)
        found = all(
            isinstance(number, Real) and not isinstance(number, bool) and math.isfinite(number) for number in numbers
        )
        if not found or (several and numbers is not value):
            raise UavrlError(f"{name} must be {'finite numbers' if several else 'a finite number'}, got {value!r}.")
        object.__setattr__(config, name, tuple(map(_plain, value)) if several else _plain(value))


def require_number(config: object, name: str, least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse a configuration whose attribute is anything but one finite number from ``least`` to ``most``."""
    value = getattr(config, name)
    is_number = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    if not is_number or not least <= float(value) <= most:
        within = "" if math.isinf(most) else f" from {least:g} to {most:g}"
        raise UavrlError(f"{name} must be a finite number{within}, got {value!r}.")
    object.__setattr__(config, name, _plain(value))


def _plain(number: Any) -> Any:
    return number.item() if isinstance(number, np.generic) else number
