"""Which guards are on, with their settings, and how ``guards=`` says so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any, get_type_hints

from pydantic import Field

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.ranges import NonNegative, Positive
from uavrl_onboard.sentences import did_you_mean
from uavrl_onboard.values import validated


@dataclass(frozen=True)
class MapSettings:
    """The map of the episode.

    Args:
        sight: distance up to which returns enter the map, in m.
    """

    sight: Annotated[float, Field(gt=0, le=40)] = 12.0


@dataclass(frozen=True)
class EvasionSettings:
    """The evasion of moving objects.

    Args:
        sight: distance up to which moving objects are detected, in m.
        objects: number of the nearest moving objects that count.
    """

    sight: Annotated[float, Field(gt=0, le=100)] = 12.0
    objects: Annotated[int, Field(ge=1, le=100)] = 3


@dataclass(frozen=True)
class ShieldSettings:
    """The shield, which limits the speed near obstacles.

    Args:
        time: shortest time in which a gap may be closed, in s.
        lag: delay from a commanded velocity to the flown one, in s.
        margin: distance kept around the hull, in m.
        nearest: shortest range that the sensor reports, in m; the margin covers at least what the sensor cannot see.
            None: that of the simulated sensor, or 0.
    """

    time: Positive = 0.7
    lag: NonNegative = 0.3
    margin: NonNegative = 0.12
    nearest: NonNegative | None = None


@dataclass(frozen=True)
class GuardSettings:
    """The settings of each guard; None for one that is off.

    The fields are in the order in which guards are applied, and nothing else holds that order.

    Examples:
        >>> GuardSettings().names, GuardSettings.all().names
        ((), ('map', 'evasion', 'shield'))
    """

    map: MapSettings | None = None
    evasion: EvasionSettings | None = None
    shield: ShieldSettings | None = None

    @classmethod
    def all(cls) -> GuardSettings:
        """Return the settings with every guard on, as it is by default."""
        return cls(**{name: kind() for name, kind in KINDS.items()})

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the guards that are on, in the order in which they are applied."""
        return tuple(name for name in NAMES if getattr(self, name) is not None)

    @property
    def sight(self) -> float | None:
        """How far the scans must reach, in m; None where no guard looks far."""
        return max((each.sight for each in (self.map, self.evasion) if each is not None), default=None)

    def plain(self) -> dict[str, dict[str, Any]]:
        """Return the guards that are on with their settings, as JSON has them."""
        return {name: asdict(getattr(self, name)) for name in self.names}


KINDS: Mapping[str, type[Any]] = {"map": MapSettings, "evasion": EvasionSettings, "shield": ShieldSettings}
NAMES = tuple(field.name for field in fields(GuardSettings))
_USAGE = "write guards=all, guards=none, or a list such as guards=[shield]"


def guard_settings(asked: Any, default: GuardSettings | None = None) -> GuardSettings:
    """Return the settings that a value of ``guards=`` asks for.

    Args:
        asked: ``all``, ``none``, a name, a list of names, a mapping of settings by guard (``{"shield": {"margin":
            0.2}}``), which changes the default, or a list of both. None: the default.
        default: guards of the policy; None: none.

    Raises:
        UavrlError: for an unknown guard or setting, a value out of range, and settings of a guard that is off.

    Examples:
        >>> guard_settings(["map", "shield"]).names
        ('map', 'shield')
        >>> guard_settings(["all", {"shield": {"margin": 0.2}}]).shield.margin
        0.2
        >>> guard_settings({"shield": {"margin": 0.2}}, GuardSettings.all()).names
        ('map', 'evasion', 'shield')
    """
    if isinstance(asked, GuardSettings):
        return asked
    items = list(asked) if isinstance(asked, Sequence) and not isinstance(asked, str) else [asked]
    chosen = [item for item in items if item is not None and not isinstance(item, Mapping)]
    changes: dict[str, dict[str, Any]] = {}
    for item in (each for each in items if isinstance(each, Mapping)):
        for name, values in item.items():
            _require_name(name, NAMES)
            if not isinstance(values, Mapping):
                raise UavrlError(f"guards.{name} must hold settings such as {_example(str(name))}, got {values!r}.")
            changes[str(name)] = changes.get(str(name), {}) | dict(values)
    named = bool(chosen) or (not changes and asked is not None)  # guards=[] means none
    found = _named(chosen) if named else (default or GuardSettings())
    for name, values in changes.items():
        if getattr(found, name) is None:
            own = "the guards asked for" if named else "the guards of this policy"
            also = f"guards=[{','.join(each for each in NAMES if each in (*found.names, name))}]"
            raise UavrlError(f"guards.{name} has settings, but {name} is not among {own}: add {also}.")
        known = validated(values, get_type_hints(KINDS[name], include_extras=True), f"guards.{name}")
        found = replace(found, **{name: replace(getattr(found, name), **known)})
    return found


def _named(chosen: Sequence[Any]) -> GuardSettings:
    """The guards of these names, as they are by default."""
    for name in chosen:
        _require_name(name, (*NAMES, "all", "none"))
    if "none" in chosen and len(chosen) > 1:
        raise UavrlError(
            f"guards cannot be none and {' and '.join(each for each in chosen if each != 'none')}: {_USAGE}."
        )
    if "all" in chosen:
        return GuardSettings.all()
    return GuardSettings(**{name: KINDS[name]() for name in NAMES if name in chosen})


def _require_name(name: Any, known: Sequence[str]) -> None:
    if name not in known:
        near = did_you_mean(str(name), known, ": ", f"{_USAGE}.")
        raise UavrlError(f"There is no guard {name!r}; the guards are {', '.join(NAMES)}{near}")


def _example(name: str) -> str:
    first = fields(KINDS[name])[0]
    return f"guards.{name}.{first.name}={first.default}"
