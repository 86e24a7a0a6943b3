"""Files that are whole or not there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives a file beside ``path`` to write to, which takes its place once it is written.

    Whoever reads meanwhile, or looks after a kill, finds the old file or the new one, and never half of one. What lay
    beside it is taken away first: it may be a link to somewhere else.

    Examples:
        >>> folder = getfixture("tmp_path")
        >>> with replacing(folder / "summary.json") as partial:
        ...     _ = partial.write_text("{}")
        >>> [path.name for path in folder.iterdir()]
        ['summary.json']
    """
    partial = path.with_name(path.name + ".partial")
    partial.unlink(missing_ok=True)
    try:
        yield partial
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
