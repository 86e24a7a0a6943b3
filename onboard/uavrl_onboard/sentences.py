"""One clear sentence for what a user can mend."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from uavrl_onboard.errors import UavrlError, did_you_mean
from uavrl_onboard.ranges import bounds, words

_EXPECTED = {
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "a text",
    "finite_number": "a finite number",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a mapping",
    "needs_python_object": "a part with a _target_",
}


def require(condition: bool, key: str, expected: str, value: Any) -> None:
    """Raises one clear sentence unless ``condition`` holds."""
    if not condition:
        raise UavrlError(_must_be(key, expected, value))


def _must_be(key: str, expected: str, value: Any) -> str:
    return f"{key} must be {expected}, got {value!r}: change it in the configuration or on the command line."


def require_known(given: Iterable[Any], known: Iterable[str], key: str) -> None:
    """Refuses names that nothing takes."""
    prefix = f"{key}." if key else ""
    names = [f"{prefix}{name}" for name in known]
    for name in (f"{prefix}{name}" for name in given):
        if name not in names:
            raise UavrlError(_no_key(name, names))


def _no_key(name: str, known: Iterable[str]) -> str:
    return f"There is no key {name!r}" + did_you_mean(name, known, ": ", "leave it out.")


def below(key: str, said: str, names: Iterable[str]) -> str:
    """What a class says of its arguments, for somebody who knows them by the keys of a configuration."""
    if not key or said.startswith(key):
        return said
    first = said.split(maxsplit=1)[0].partition(".")[0]
    return f"{key}.{said}" if first in names else f"{key}: {said}"


def explained(error: ValidationError, values: Mapping[str, Any], hints: Mapping[str, Any], key: str) -> UavrlError:
    """What pydantic found wrong, as one sentence about the innermost of its complaints about the first value.

    Args:
        error: of the values.
        values: by their names.
        hints: their types.
        key: of the part that holds them.
    """
    details = error.errors(include_url=False)
    placed = [(_place(each["loc"], values), each) for each in details if each["loc"][0] == details[0]["loc"][0]]
    innermost = max(len(place) for place, _ in placed)
    complaints = [each for place, each in placed if len(place) == innermost]
    place, first = next((place, each) for place, each in placed if each is complaints[0])
    names = [step for step in place if isinstance(step, str)]
    where = ".".join(filter(None, [key, *names]))
    kind, given = first["type"], first["input"]
    types = list(_types(hints[names[0]], names[1:-1] if kind == "unexpected_keyword_argument" else names[1:]))
    fields = [name for each in types if isinstance(each, type) and is_dataclass(each) for name in get_type_hints(each)]
    if kind == "unexpected_keyword_argument":
        return UavrlError(_no_key(where, [f"{where.rpartition('.')[0]}.{name}" for name in fields]))
    if kind == "value_error":  # what a class says of itself
        return UavrlError(below(where, str(first["ctx"]["error"]), fields))
    if kind == "missing" and isinstance(given, Mapping):
        return UavrlError(f"{where}.{first['loc'][-1]} is missing: give it in the configuration.")
    told = [each for each in complaints if each["type"] != "needs_python_object"] or complaints
    expected = " or ".join(dict.fromkeys(_expected(each, types, len(details)) for each in told))
    return UavrlError(_must_be(where, expected, given))


def _place(loc: Iterable[int | str], values: Any) -> list[int | str]:
    """Where in the values something is; what pydantic calls the members of a union is left out."""
    place: list[int | str] = []
    for step in loc:
        if step in (range(len(values)) if isinstance(values, list) else values if isinstance(values, Mapping) else ()):
            place.append(step)
            values = values[step]
    return place


def _types(hint: Any, names: list[str]) -> Iterator[Any]:
    """A type and those that it is made of, where names lead through the fields of dataclasses."""
    if not names:
        yield hint
    elif isinstance(hint, type) and is_dataclass(hint):
        yield from _types(get_type_hints(hint, include_extras=True).get(names[0]), names[1:])
    for member in get_args(hint):
        yield from _types(member, names)


def _expected(error: ErrorDetails, types: list[Any], complaints: int) -> str:
    kind, context = error["type"], error.get("ctx", {})
    if kind == "literal_error":
        return "one of " + context["expected"].replace("'", "").replace(" or ", ", ")
    if kind == "dataclass_type":
        name = context["class_name"]
        keys = [key for each in types if getattr(each, "__name__", "") == name for key in get_type_hints(each)]
        return f"the settings of {name} ({', '.join(keys[:3])}{', …' * (len(keys) > 3)})"
    if kind in ("missing", "too_long"):
        return f"a list of {context.get('max_length', len(error['input']) + complaints)}"
    for annotated in (each for each in types if get_origin(each) is Annotated):
        known = {name: value for part in annotated.__metadata__ for name, value in bounds(part).items()}
        if context and context.items() <= known.items():
            return words(**known)
    return _EXPECTED.get(kind) or error["msg"].removeprefix("Input should be ")
