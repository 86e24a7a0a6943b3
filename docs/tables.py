"""What in a table's cell stays in one line: a rate, and its interval."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from docutils import nodes

_PIECE = re.compile(r"\([+−-]?\d[^()]{0,24}\)|[+−-]?\d[\d.,]*(?:[–-]\d[\d.,]*)? %")


def pieces(text: str) -> Iterator[tuple[str, bool]]:
    """The pieces of a cell's text in order, each with whether it must not be broken."""
    end = 0
    for match in _PIECE.finditer(text):
        if match.start() > end:
            yield text[end : match.start()], False
        yield match[0], True
        end = match.end()
    if end < len(text):
        yield text[end:], False


def keep_together(doctree: nodes.document) -> None:
    """Marks these pieces in all tables of a page with the class ``together``."""
    from docutils import nodes  # what comes before needs none of it

    for entry in doctree.findall(nodes.entry):
        for text in list(entry.findall(nodes.Text)):
            parts = list(pieces(text.astext()))
            if isinstance(text.parent, nodes.literal) or not any(whole for _, whole in parts):
                continue
            made = [
                nodes.inline("", part, classes=["together"]) if whole else nodes.Text(part) for part, whole in parts
            ]
            text.parent.replace(text, made)
