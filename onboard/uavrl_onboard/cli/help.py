"""The text of ``--help``, for the commands of both packages."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple


class About(NamedTuple):
    """The parts of a command's help besides its keys."""

    name: str
    summary: str
    examples: Sequence[str]
    most_used: str = ""  #: the keys that ``--help`` shows, separated by blanks; empty for all


class Key(NamedTuple):
    """A key of a command."""

    name: str
    default: str  #: as it is typed; empty for a key that contains others
    meaning: str


def show(arguments: Sequence[str], version: str, text: Callable[..., str]) -> bool:
    """Print the version, or the ``text`` of the help, if a command line asks for it; return whether it does."""
    asked = [argument for argument in arguments if argument in ("--help", "-h", "--help=all")]
    if arguments[:1] == ["--version"]:
        print(version)
    elif asked:
        print(text(every_key=asked[0] == "--help=all"))
    else:
        return False
    return True


def render_help(
    about: About,
    keys: Iterable[Key],
    *,
    every_key: bool = False,
    choices: Mapping[str, str] | None = None,
    more: Sequence[str] = (),
) -> str:
    """Return the help of a command, with its most common keys or with all; ``choices`` are those of each group."""
    known = {key.name: key for key in keys}
    lines = [f"{about.name}: {about.summary}", "", f"Usage: {about.name} KEY=VALUE …"]
    lines += [f"  {about.name} {example}" for example in about.examples]
    if choices:
        lines += ["", "Choices, with [the default] in brackets", *_table(choices)]
    if every_key:
        shown = {name: f"{key.meaning} ({key.default})" if key.default else key.meaning for name, key in known.items()}
        lines += ["", "All keys, with their default in brackets", *_table(shown)]
    else:
        shown = {name: known[name].meaning for name in about.most_used.split() or known}
        lines += ["", "Most common keys", *_table(shown), "", f"All keys: {about.name} --help=all"]
    return "\n".join([*lines, *more])


def _table(rows: Mapping[str, str], longest: int = 24) -> list[str]:
    """Return the lines of two columns; a name with more than ``longest`` characters has its own line."""
    width = min(max(map(len, rows)), longest) + 2
    room = max(shutil.get_terminal_size().columns, 80)
    lines = []
    for name, text in rows.items():
        wrapped = textwrap.wrap(text, room - width - 3)
        if len(name) > longest:
            lines.append(f"  {name}")
            name = ""
        lines += [f"  {name if not n else '':{width}}{part}" for n, part in enumerate(wrapped)]
    return lines
