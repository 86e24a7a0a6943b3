"""What the API pages show of a constructor's arguments: names, defaults, and types with their ranges in words."""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable
from typing import Annotated, Any, Union

from uavrl_onboard import ranges
from uavrl_onboard.ranges import Rule, bounds, words


class MadeAnew:
    """Stands for a default that each object gets of its own, or that is code."""

    def __repr__(self) -> str:
        return "..."


def signature_of(thing: Callable[..., Any], bound: bool = False) -> inspect.Signature:
    """The signature of a function, of a method as it is called, or of a class's own constructor."""
    call = thing.__init__ if isinstance(thing, type) else thing  # type: ignore[misc]
    if getattr(thing, "_is_protocol", False):
        return inspect.Signature()
    signature = inspect.signature(call)
    try:
        hints, types_alone = (typing.get_type_hints(call, include_extras=extras) for extras in (True, False))
    except NameError:  # of a name that only type checkers import: types stay as they are written
        hints = types_alone = {}
    hints = {name: in_words(hint) if has_range(hint) else types_alone[name] for name, hint in hints.items()}
    parameters = list(signature.parameters.values())[isinstance(thing, type) or bound :]
    shown = [_shown(each, hints.get(each.name, each.annotation)) for each in parameters]
    returned = signature.empty if isinstance(thing, type) else hints.get("return", signature.return_annotation)
    return signature.replace(parameters=shown, return_annotation=returned)


def _shown(parameter: inspect.Parameter, hint: Any) -> inspect.Parameter:
    default = parameter.default
    factory = type(default).__name__ == "_HAS_DEFAULT_FACTORY_CLASS"
    code = callable(default) or repr(default).startswith("lambda")  # which Sphinx keeps as the text of its source
    if default is not parameter.empty and (factory or code):
        default = MadeAnew()
    return parameter.replace(annotation=hint, default=default)


def has_range(hint: Any) -> bool:
    """Whether a type holds a range somewhere."""
    return _range(hint) is not None or any(map(has_range, typing.get_args(hint)))


def in_words(hint: Any) -> str:
    """A type with its ranges: ``float > 0``, ``int ≥ 1 | None``."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        name = in_words(arguments[0])
        told = _range(hint)
        return name if told is None else _with_range(name, told)
    if origin in (Union, types.UnionType):
        return " | ".join(map(in_words, arguments))
    if origin is not None:
        return f"{origin.__name__}[{', '.join(map(in_words, arguments))}]"
    return "None" if hint is type(None) else "..." if hint is Ellipsis else getattr(hint, "__name__", str(hint))


def ranges_in_words() -> str:
    """The types of :mod:`uavrl_onboard.ranges` as a table in Markdown."""
    named = {name: hint for name, hint in vars(ranges).items() if typing.get_origin(hint) is Annotated}
    rows = [f"| `{name}` | {in_words(hint)} |" for name, hint in named.items() if has_range(hint)]
    return "\n".join(["| name | type |", "|---|---|", *rows])


def _range(hint: Any) -> str | None:
    """The range beside a type, in words."""
    beside = getattr(hint, "__metadata__", ())
    limits = {name: value for each in beside for name, value in bounds(each).items()}
    return words(**limits) if limits else next((each.words for each in beside if isinstance(each, Rule)), None)


def _with_range(name: str, words: str) -> str:
    for begin, sign in (("above ", " > "), ("at least ", " ≥ "), ("in ", " in ")):
        if words.startswith(begin):
            return name + sign + words.removeprefix(begin)
    return f"{name}, {words}"
