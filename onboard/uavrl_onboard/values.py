"""Plain data of a configuration, validated against the types of what it is for."""

import json
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Union, get_args, get_origin

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.errors import PydanticUserError
from typing_extensions import TypedDict  # of which pydantic asks for this one under Python 3.11

from uavrl_onboard.ranges import Text
from uavrl_onboard.sentences import explained, require, require_known

MOST = 1e15  # of any number: larger ones are slips, and overflow where they are used
_STRICT = ConfigDict(strict=True, extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False)


def validated(values: Mapping[str, Any], hints: Mapping[str, Any], key: str = "") -> dict[str, Any]:
    """The values as their types have them: known, of their type and in their range.

    They are read as JSON, strictly: a list may be a tuple and a whole number a float, a text is no number.

    Args:
        values: plain data, by their names.
        hints: the types of all names that may be given.
        key: of the part that holds them.

    Raises:
        UavrlError: naming the key that is unknown, of another type or out of range.
    """
    require_known(values, hints, key)
    known = {name: _texts(hints[name]) for name in values}
    try:
        found: dict[str, Any] = _adapter(known).validate_json(json.dumps(values))
    except ValidationError as error:
        raise explained(error, values, known, key) from error
    for name, value in values.items():
        _require_sane(value, f"{key}.{name}" if key else name)
    return found


def to_plain(value: Any) -> Any:
    """Dataclasses as mappings and tuples as lists, as yaml has them."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(name): to_plain(child) for name, child in value.items()}
    return [to_plain(child) for child in value] if isinstance(value, list | tuple) else value


def _texts(hint: Any) -> Any:
    """The type, with a number for a text."""
    if get_origin(hint) in (Union, types.UnionType):
        return Union[tuple(map(_texts, get_args(hint)))]  # noqa: UP007
    return Text if hint is str else hint


def _adapter(hints: Mapping[str, Any]) -> TypeAdapter[dict[str, Any]]:
    typed_dict: Any = TypedDict
    kind = typed_dict("Values", dict(hints))
    kind.__pydantic_config__ = _STRICT
    try:
        return TypeAdapter(kind)
    except (PydanticUserError, NameError):
        return _adapter({name: hint if _is_known(hint) else Any for name, hint in hints.items()})


def _is_known(hint: Any) -> bool:
    """Whether pydantic knows a type; what has another one may be anything."""
    listed: Any = types.GenericAlias(tuple, (hint,))  # of its own a dataclass takes no configuration
    try:
        TypeAdapter(listed, config=_STRICT)
    except (PydanticUserError, NameError):
        return False
    return True


def _require_sane(value: Any, key: str) -> None:
    if isinstance(value, Mapping):
        for name, child in value.items():
            _require_sane(child, f"{key}.{name}")
    for number in value if isinstance(value, list) else [value]:
        if isinstance(number, int | float) and abs(number) > MOST:
            require(False, key, f"at most {MOST:g}" if number > 0 else f"at least {-MOST:g}", number)
