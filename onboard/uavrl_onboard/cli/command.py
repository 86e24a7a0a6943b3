"""The command line of uavrl-fly and uavrl-scan: ``KEY=VALUE``, checked against a dataclass.

The dataclass's docstring is the help.
"""

from __future__ import annotations

import inspect
import json
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import partial, wraps
from typing import Any, NoReturn, TypeVar, get_type_hints

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from uavrl_onboard import __version__
from uavrl_onboard.cli.help import About, Key, render_help, show
from uavrl_onboard.cli.process import command_process, configure_logging
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.command_line import KEY as GUARDS
from uavrl_onboard.guards.command_line import join_guards
from uavrl_onboard.sentences import did_you_mean
from uavrl_onboard.values import to_plain, validated

T = TypeVar("T")
SLIP = 0.85  # of a key: one so near to another was meant as that
_ARGUMENT = re.compile(r"^(\w+): ", re.MULTILINE)


def command(about: About, kind: type[T]) -> Callable[[Callable[[T], Any]], Callable[[], None]]:
    """Makes a console command of a function that takes the settings ``kind``, a dataclass."""

    def decorate(function: Callable[[T], Any]) -> Callable[[], None]:
        @wraps(function)
        def main() -> None:
            with command_process():
                arguments = sys.argv[1:]
                if not show(arguments, f"{about.name} {__version__}", partial(render_help, about, keys(kind))):
                    configure_logging()
                    function(settings(about, kind, arguments))

        return main

    return decorate


def settings(about: About, kind: type[T], arguments: Sequence[str]) -> T:
    """The settings that a command line asks for.

    Raises:
        UavrlError: naming the argument that is no KEY=VALUE, or the key that is unknown, of another type or out of
            range.
    """
    known = [key.name for key in keys(kind)]
    arguments = join_guards(arguments) if GUARDS in known else arguments
    for argument in arguments:
        _require_key_and_value(about, argument, known)
    try:
        given: Any = OmegaConf.to_container(OmegaConf.from_cli(list(arguments)))
    except (OmegaConfBaseException, YAMLError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise UavrlError(
            f"The values cannot be read ({reason}): write KEY=VALUE, and quote special characters."
        ) from error
    return kind(**validated(given, get_type_hints(kind, include_extras=True)))


def _require_key_and_value(about: About, argument: str, known: Sequence[str]) -> None:
    key, equals, _ = argument.partition("=")
    if argument.startswith("-"):
        refuse_option(about.name, argument, known)
    if not equals:
        raise UavrlError(f"{argument!r} is no KEY=VALUE: write KEY=VALUE, as in {about.name} {about.examples[0]}.")
    groups = {each.rpartition(".")[0] for each in known}
    if key not in known and key not in groups:
        raise UavrlError(f"There is no key {key!r}" + did_you_mean(key, known, ": ", "--help=all lists all keys."))


def refuse_option(command: str, option: str, known: Sequence[str]) -> NoReturn:
    """Refuses what looks like an option, and says how its key is written."""
    key, _, value = option.lstrip("-").partition("=")
    if key in known:
        raise UavrlError(f"{command} has no option {option}: write {key}={value or 'VALUE'}.")
    otherwise = "values are written KEY=VALUE, and --help explains the keys."
    raise UavrlError(f"{command} has no option {option}{did_you_mean(key, known, ': ', otherwise, SLIP)}")


def keys(kind: type[Any], prefix: str = "") -> Iterator[Key]:
    """Iterate over the keys of a dataclass and of the dataclasses in it, with dotted names."""
    hints, meanings = get_type_hints(kind), documented(kind)
    for field in fields(kind):
        hint = hints[field.name]
        if isinstance(hint, type) and is_dataclass(hint):
            yield from keys(hint, f"{prefix}{field.name}.")
        else:
            default = field.default_factory() if field.default_factory is not MISSING else field.default
            yield Key(f"{prefix}{field.name}", _written(default), meanings.get(field.name, ""))


def documented(kind: type[Any]) -> dict[str, str]:
    """What the ``Args`` of a class's docstring, and of its bases', say of each argument."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        text = inspect.cleandoc(each.__doc__ or "").partition("Args:\n")[2]
        block = textwrap.dedent(re.split(r"\n(?=\S)", text, maxsplit=1)[0])
        parts = _ARGUMENT.split(block)[1:]
        found |= {name: " ".join(said.split()).rstrip(".") for name, said in zip(parts[::2], parts[1::2], strict=True)}
    return found


def _written(value: Any) -> str:
    """Return a value as it is typed on the command line."""
    value = to_plain(value)
    if isinstance(value, list):
        return f"[{','.join(map(_written, value))}]"
    if isinstance(value, float):
        return f"{value:g}"
    return value if isinstance(value, str) else json.dumps(value)
