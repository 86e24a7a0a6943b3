"""What is mended in a page's HTML before Sphinx writes it."""

from __future__ import annotations

import re
from collections.abc import Callable


def without_empty_headers(html: str) -> str:
    """Drops header rows that say nothing, and makes the empty corner of a table a cell that is no header."""

    def is_empty(part: str) -> bool:
        return "<img" not in part and not re.sub(r"<[^>]*>", "", part).strip()

    html = re.sub(r"<thead>.*?</thead>\n?", lambda row: "" if is_empty(row[0]) else row[0], html, flags=re.DOTALL)
    return re.sub(
        r"<th\b([^>]*)>(.*?)</th>",
        lambda cell: f"<td{cell[1]}>{cell[2]}</td>" if is_empty(cell[2]) else cell[0],
        html,
        flags=re.DOTALL,
    )


def with_lines_of_arguments(html: str) -> str:
    """Makes the arguments of a long signature lines: Sphinx makes them a list of definitions without terms."""
    return re.sub(
        r"<dl>(\s*<dd>.*?)</dl>",
        lambda found: f'<div class="sig-lines">{found[1].replace("<dd>", "<div>").replace("</dd>", "</div>")}</div>',
        html,
        flags=re.DOTALL,
    )


def with_links_back(html: str, module: str, address: Callable[[str], str | None]) -> str:
    """Leads from the code of a module back to where each name is documented.

    ``sphinx.ext.viewcode`` believes that all names of a file are public in the same module, that of the first one.
    Here it is the module itself or the nearest package above it for which ``address`` gives something.
    """
    parts = module.split(".")

    def link(found: re.Match[str]) -> str:
        names = (".".join([*parts[:length], found[2]]) for length in range(len(parts), 0, -1))
        return found[1] + next(filter(None, map(address, names)), found[3])

    return re.sub(r'(id="([\w.]+)">\n<a class="viewcode-back" href=")([^"]*)', link, html)
