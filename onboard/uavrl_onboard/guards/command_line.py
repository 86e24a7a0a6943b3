"""``guards=`` and ``guards.NAME.KEY=`` on a command line, as one value."""

from __future__ import annotations

from collections.abc import Sequence

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.settings import NAMES

KEY = "guards"


def join_guards(arguments: Sequence[str]) -> list[str]:
    """Return a command line in which all that is said about guards is one argument, ``guards=VALUE``.

    A parser of ``KEY=VALUE`` cannot take both ``guards=all`` and ``guards.shield.margin=0.2``, since the first is a
    text and the second a setting below it.

    Raises:
        UavrlError: for a setting without a guard.

    Examples:
        >>> join_guards(["policy=best", "guards=[map,shield]", "guards.shield.margin=0.2"])
        ['policy=best', 'guards=[map,shield,{shield: {margin: 0.2}}]']
        >>> join_guards(["guards.shield.margin=0.2", "guards.shield.lag=0.1"])
        ['guards=[{shield: {margin: 0.2}},{shield: {lag: 0.1}}]']
    """
    kept, items, settings, at = list[str](), list[str](), list[str](), None
    for argument in arguments:
        key, _, value = argument.partition("=")
        key = key.lstrip("+")
        if key != KEY and not key.startswith(f"{KEY}."):
            kept.append(argument)
            continue
        at = len(kept) if at is None else at
        if key == KEY:
            items = [value]
        else:
            settings.append(_setting(key, value))
    if at is not None:
        said = items[0] if items else ""
        if settings:
            inner = said.strip()[1:-1] if said.strip().startswith("[") else "" if said == "null" else said
            said = f"[{','.join(filter(None, [inner, *settings]))}]"
        kept.insert(at, f"{KEY}={said}")
    return kept


def _setting(key: str, value: str) -> str:
    """One setting as an item of the list."""
    parts = key.split(".")
    if len(parts) != 3 or not value:
        raise UavrlError(
            f"{key} is no setting of a guard: write guards.GUARD.SETTING=VALUE, as in guards.shield.margin=0.2; the "
            f"guards are {', '.join(NAMES)}."
        )
    return f"{{{parts[1]}: {{{parts[2]}: {value}}}}}"
