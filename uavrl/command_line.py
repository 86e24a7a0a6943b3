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
    """What was typed as ``KEY=VALUE``, as Hydra reads it: what it cannot read is a text, or a list of texts.

    Hydra's grammar knows ASCII letters and some signs; folders have other names, too.

    Examples:
        >>> readable("run=/home/jürgen/runs (1)"), readable("runs=[a,ü]"), readable("episodes=60"), readable("a=[1,2")
        ('run="/home/jürgen/runs (1)"', 'runs=[a,"ü"]', 'episodes=60', 'a=[1,2')
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    key, _, value = given.partition("=")
    listed = value.startswith("[") and value.endswith("]")
    texts = value[1:-1].split(",") if listed else [value]
    if not key or not value or any(set(text) & set("\"'[]{},") for text in texts):
        return given
    try:
        OverridesParser.create().parse_override(given)
    except HydraException:
        return override(key, texts if listed else value)
    return given


def _text(value: object) -> str:
    text = _folder(value)
    if not isinstance(value, str | Path) or (_PLAIN.fullmatch(text) and text.lower() not in _NO_TEXT):
        return text
    text = re.sub(r'(\\*)"', r'\1\1\\"', text)  # backslashes are doubled before a quote, and there alone
    text = re.sub(r"(\\+)$", r"\1\1", text)
    return f'"{text}"'


def _folder(value: object) -> str:
    """A folder of the name ``~`` lies here, not at home."""
    text = str(value)
    return f"./{text}" if isinstance(value, Path) and text.startswith(("~", "-")) else text
