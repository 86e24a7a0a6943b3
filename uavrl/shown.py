"""How the transforms of the library show themselves."""

import inspect
from typing import Any, Self

from torch import nn

LONGEST = 80  # characters of an argument that are shown


class Shown:
    """Shows a part by its constructor call: what must be passed, and what differs from its default.

    Examples:
        >>> from uavrl.transforms import NavigationObservation
        >>> NavigationObservation(radius=1.5)
        NavigationObservation(radius=1.5)
    """

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Remember the arguments; a copy gets them with the rest of its state."""
        made = super().__new__(cls)
        signature = inspect.signature(cls.__init__)
        try:
            given = dict(signature.bind(made, *args, **kwargs).arguments)
        except TypeError:  # a copy has none, and of a mistake __init__ tells
            given = {}
        parameters = list(signature.parameters.values())[1:]
        for each in parameters:
            if each.kind is each.VAR_KEYWORD:
                given |= given.pop(each.name, {})
        defaults = {each.name: each.default for each in parameters}
        told = {name: value for name, value in list(given.items())[1:] if not _same(value, defaults.get(name, made))}
        made.__dict__["_told"] = told
        return made

    def __repr__(self) -> str:
        """Return the constructor call."""
        told = ", ".join(f"{name}={_short(value)}" for name, value in self.__dict__.get("_told", {}).items())
        return f"{type(self).__name__}({told})"


def _same(value: Any, default: Any) -> bool:
    if isinstance(value, list | tuple) and isinstance(default, list | tuple):
        return list(value) == list(default)
    return value is default or (isinstance(value, str | int | float | bool) and bool(value == default))


def _short(value: Any) -> str:
    if isinstance(value, nn.Module) and not isinstance(value, Shown):
        return f"{type(value).__name__}(...)"
    if inspect.isroutine(value):
        return value.__name__
    text = " ".join(repr(value).split())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."
