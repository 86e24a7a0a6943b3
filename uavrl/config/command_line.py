"""Command lines as they are typed and printed: quoted for Hydra, and for the shell around it."""

import re
import shlex
from collections.abc import Iterable
from pathlib import Path

# What Hydra reads as the text that it is. It reads other words as numbers, truth values or parts of its grammar.
_PLAIN = re.compile(r"[A-Za-z0-9_./%@+-]*/[A-Za-z0-9_./%@+-]*|\.{1,2}|[A-Za-z_][A-Za-z0-9_.-]*")
_NO_TEXT = ("true", "false", "null", "nan", "inf")


def command_line(command: str, *words: object, **values: object) -> str:
    """A command as it is typed.

    Args:
        command: ``uavrl-evaluate``, say.
        *words: what stands behind it as it is: options, folders.
        **values: what Hydra reads as ``KEY=VALUE``; a list is written as one.

    Examples:
        >>> print(command_line("uavrl-export", Path("my runs/a")))
        uavrl-export 'my runs/a'
        >>> print(command_line("uavrl-evaluate", run="runs/a", packages=["mine"]))
        uavrl-evaluate run=runs/a 'packages=[mine]'
        >>> print(command_line("uavrl-evaluate", run="my runs/lr=1"))
        uavrl-evaluate 'run="my runs/lr=1"'
    """
    told = [_folder(word) for word in words]
    return shlex.join([command, *told, *(override(key, value) for key, value in values.items())])


def trusting(packages: Iterable[str]) -> dict[str, list[str]]:
    """The values of a command that runs the code of some packages; none for no packages.

    Examples:
        >>> print(command_line("uavrl-train", resume="runs/a", **trusting(["mine"])))
        uavrl-train resume=runs/a 'packages=[mine]'
        >>> print(command_line("uavrl-train", resume="runs/a", **trusting([])))
        uavrl-train resume=runs/a
    """
    return {"packages": listed} if (listed := list(packages)) else {}


def override(key: str, value: object) -> str:
    """``KEY=VALUE`` as Hydra reads it: with quotes where it would take a text for something else.

    Examples:
        >>> override("run", "runs/a"), override("run", "100"), override("run", "müll")
        ('run=runs/a', 'run="100"', 'run="müll"')
    """
    if not isinstance(value, str | Path) and isinstance(value, Iterable):
        return f"{key}=[{','.join(_text(item) for item in value)}]"
    return f"{key}={_text(value)}"


def readable(given: str) -> str:
    """What was typed as ``KEY=VALUE``, as Hydra reads it: a value that it cannot read, and that is no list, is a text.

    Hydra's grammar knows ASCII letters and some signs; folders have other names, too.

    Examples:
        >>> readable("run=/home/jürgen/runs (1)"), readable("episodes=60"), readable("seeds=[1,2")
        ('run="/home/jürgen/runs (1)"', 'episodes=60', 'seeds=[1,2')
    """
    key, _, value = given.partition("=")
    if not (key and value) or set(value) & set("\"'[]{},") or _is_read(given) or not _is_read(f"{key}=text"):
        return given
    return override(key, value.strip())


def _is_read(given: str) -> bool:
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        OverridesParser.create().parse_override(given)
    except HydraException:
        return False
    return True


def _text(value: object) -> str:
    text = _folder(value)
    if not isinstance(value, str | Path) or (_PLAIN.fullmatch(text) and text.lower() not in _NO_TEXT):
        return text
    text = re.sub(r'(\\*)"', r'\1\1\\"', text)  # backslashes are doubled before a quote, and there alone
    text = re.sub(r"(\\+)\Z", r"\1\1", text)
    return f'"{text}"'


def _folder(value: object) -> str:
    """A folder of the name ``~`` lies here, not at home."""
    text = str(value)
    return f"./{text}" if isinstance(value, Path) and text.startswith(("~", "-")) else text
