"""Says what is wrong with a folder of built pages: ``python -m tools.check_site FOLDER``, the last step of `make docs`.

Read without a browser and by the standard library alone: links to files and anchors that are not there, ids that occur
twice, pictures without alternative text, pages without one title, language and heading, and some of what a screen
reader misses.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """What one page links to, is linked by, and lacks.

    Args:
        text: The page's HTML.

    Attributes:
        ids: How often each id occurs.
        names: Anchors of old, ``<a name=…>``.
        links: What ``href``, ``src`` and ``for`` name, the last as ``#ID``.
        faults: What the page lacks by itself, each as the end of a sentence.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: Counter[str] = Counter()
        self.names: set[str] = set()
        self.links: dict[str, None] = {}
        self.faults: list[str] = []
        self._open: list[tuple[str, int]] = []  # each with how much had been read, as text or pictures, before it
        self._read = 0
        self._seen: Counter[str] = Counter()
        self._terms: list[bool] = []  # of each open list of definitions, whether it has a term
        self._language = ""
        self.feed(text)
        self.close()
        for name in ("title", "h1"):
            if self._seen[name] != 1:
                self.faults.append(f"has {self._seen[name]} <{name}> with text, in place of one")
        if not self._language:
            self.faults.append("does not say its language: <html lang=…>")
        self.faults += [f'has the id "{name}" {count} times' for name, count in self.ids.items() if count > 1]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Called by the parser."""
        of = {name: value or "" for name, value in attrs}
        if "id" in of:
            self.ids[of["id"]] += 1
        self.links.update(dict.fromkeys(of[name].strip() for name in ("href", "src") if name in of))
        if tag == "label" and "for" in of:
            self.links[f"#{of['for']}"] = None
        if tag == "a" and "name" in of:
            self.names.add(of["name"])
        if tag == "html":
            self._language = of.get("lang", "").strip()
        if tag == "img":
            self._read += 1
            shown = of.get("src", "").rpartition("/")[2]
            if "alt" not in of or of["alt"].rpartition("/")[2] == shown:  # where Sphinx has none it names the file
                self.faults.append(f"shows {of.get('src')} without alternative text: <img alt=…>")
        if of.get("role") == "heading" and "aria-level" not in of:
            self.faults.append(f"has a <{tag} role=heading> without aria-level")
        if tag == "aside" and not (of.get("aria-label") or of.get("aria-labelledby")):
            self.faults.append(f"has an <aside class={of.get('class')}> without aria-label")
        if tag == "dl":
            self._terms.append(False)
        if tag == "dt" and self._terms:
            self._terms[-1] = True
        self._open.append((tag, self._read))

    def handle_data(self, data: str) -> None:
        """Called by the parser."""
        self._read += len(data.strip())

    def handle_endtag(self, tag: str) -> None:
        """Called by the parser."""
        if tag not in [name for name, _ in self._open]:
            return
        while self._open:
            name, before = self._open.pop()
            self._closed(name, self._read > before)
            if name == tag:
                return

    def _closed(self, tag: str, has_content: bool) -> None:
        if tag in ("title", "h1") and has_content and "svg" not in [name for name, _ in self._open]:
            self._seen[tag] += 1
        if tag == "th" and not has_content:
            self.faults.append("has a table with an empty header cell: <th>")
        if tag == "dl" and not self._terms.pop():
            self.faults.append("has a list of definitions without a term: <dl> without <dt>")


def broken_links(place: Path, pages: dict[Path, Page], folder: Path) -> Iterator[str]:
    """What one of a folder's pages links to and is not there, each as the end of a sentence."""
    for link in pages[place].links:
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            continue
        file = (place.parent / unquote(parts.path)).resolve() if parts.path else place
        file = file / "index.html" if file.is_dir() else file
        anchor = unquote(parts.fragment)
        if not file.is_relative_to(folder):
            yield f"links to {link}, which is not of the site"
        elif not file.is_file():
            yield f"links to {link}, where no file is"
        elif anchor not in ("", "top") and file in pages and anchor not in {*pages[file].ids, *pages[file].names}:
            yield f"links to {link}, where no such anchor is"


def faults(folder: Path) -> list[str]:
    """What is wrong with the pages of a folder, one sentence each."""
    folder = folder.resolve()
    pages = {place: Page(place.read_text(encoding="utf-8")) for place in sorted(folder.rglob("*.html"))}
    if not pages:
        return [f"Expected built pages in {folder}, found no .html: build them with make docs."]
    return [
        f"{place.relative_to(folder)} {fault}."
        for place, page in pages.items()
        for fault in [*page.faults, *broken_links(place, pages, folder)]
    ]


def main() -> None:
    """Reads the command line, and says what is wrong, if anything."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the built pages")
    folder = parser.parse_args().folder
    found = faults(folder)
    print("\n".join([*found, f"{len(found) or 'no'} faults in the pages of {folder}"]))
    if found:
        sys.exit(f"Pages of builds before may be among them: rm -r {folder} and build again.")


if __name__ == "__main__":
    main()
