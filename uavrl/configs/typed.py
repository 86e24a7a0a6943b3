"""Plain data of a configuration, held against the types of what it is for."""

import math
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from uavrl.configs.checks import did_you_mean, require
from uavrl.configs.limits import check_most
from uavrl.configs.signature import Other
from uavrl.errors import UavrlError
from uavrl.ranges import HOME, Range

_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def typed(value: Any, hint: Any, key: str) -> Any:
    """The value as a type has it."""
    if isinstance(value, float):
        require(math.isfinite(value), key, "a finite number", value)
    check_most(key, value)
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        value = typed(value, arguments[0], key)
        for allowed in arguments[1:]:
            if isinstance(allowed, Range):
                require(allowed.holds(value), key, allowed.words, value)
            elif allowed == HOME and value.startswith("~"):
                value = _at_home(value, key)
        return value
    if origin in (Union, types.UnionType):
        return _one_of(value, arguments, key)
    if origin is Literal:
        require(value in arguments, key, f"one of {', '.join(map(str, arguments))}", value)
        return value
    if is_dataclass(hint) and isinstance(hint, type):
        return value if isinstance(value, hint) else _made(value, hint, key)
    if (origin or hint) in (tuple, list, Sequence):
        return _listed(value, arguments, key)
    return _plain(value, hint, key)


def _at_home(value: str, key: str) -> str:
    try:
        return str(Path(value).expanduser())
    except RuntimeError:  # there is no such user
        require(False, key, f"a folder, where one that is called so is written ./{value}", value)
        raise


def _plain(value: Any, hint: Any, key: str) -> Any:
    if hint not in _WORDS:
        return value
    if hint is str and isinstance(value, int | float) and not isinstance(value, bool):
        return str(value)
    fits = isinstance(value, (int, float) if hint is float else hint) and (hint is bool or not isinstance(value, bool))
    require(fits, key, _WORDS[hint], value)
    return float(value) if hint is float else value


def _one_of(value: Any, hints: Sequence[Any], key: str) -> Any:
    if value is None and type(None) in hints:
        return None
    chosen = [hint for hint in hints if hint is not type(None) and (hint is not Other or isinstance(value, Mapping))]
    chosen = chosen or [Other]
    for hint in chosen[:-1]:
        try:
            return typed(value, hint, key)
        except UavrlError:
            continue
    return typed(value, chosen[-1], key)


def _listed(value: Any, hints: Sequence[Any], key: str) -> tuple[Any, ...]:
    require(isinstance(value, list | tuple), key, "a list", value)
    if (len(hints) == 2 and hints[1] is Ellipsis) or len(hints) <= 1:
        return tuple(typed(item, hints[0] if hints else Any, key) for item in value)
    words = "three numbers, one for each axis" if len(hints) == 3 else f"a list of {len(hints)}"
    if len(value) != len(hints):
        raise UavrlError(f"{key} takes {words}, got {list(value)}: change it in the configuration.")
    return tuple(typed(item, hint, key) for item, hint in zip(value, hints, strict=True))


def _made(value: Any, kind: type, key: str) -> Any:
    require(isinstance(value, Mapping), key, f"the settings of {kind.__name__}", value)
    hints = typing.get_type_hints(kind, include_extras=True)
    prefix = f"{key}." if key else ""
    require_known(value, [field.name for field in fields(kind)], key)
    options = {str(name): typed(child, hints[name], f"{prefix}{name}") for name, child in value.items()}
    try:
        return kind(**options)
    except (ValueError, TypeError) as error:
        raise UavrlError(below(key, str(error), hints)) from error


def below(key: str, said: str, names: Iterable[str]) -> str:
    """What a class says of its arguments, for somebody who knows them by the keys of a configuration."""
    if not key or said.startswith(key):
        return said
    first = said.split(maxsplit=1)[0].partition(".")[0]
    return f"{key}.{said}" if first in names else f"{key}: {said}"


def require_known(given: Iterable[Any], known: Iterable[str], key: str) -> None:
    """Refuses names that nothing takes."""
    prefix = f"{key}." if key else ""
    names = list(known)
    for name in map(str, given):
        if name not in names:
            near = did_you_mean(f"{prefix}{name}", [f"{prefix}{n}" for n in names], ": ", "leave it out.")
            raise UavrlError(f"There is no key {prefix + name!r}{near}")
