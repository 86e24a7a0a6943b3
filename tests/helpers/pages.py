"""What a flight page holds."""

from __future__ import annotations

import base64
from html.parser import HTMLParser
from typing import Any

import numpy as np


class Page(HTMLParser):
    """Collects what a page would fetch, and the text of its scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.scripts: dict[str, str] = {}
        self._script = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {key: value or "" for key, value in attrs}
        self.fetched += [values[key] for key in ("src", "href", "srcset", "action") if key in values]
        if tag == "script":
            self._script = values.get("id", f"script {len(self.scripts)}")

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self._script = ""

    def handle_data(self, data: str) -> None:
        if self._script:
            self.scripts[self._script] = self.scripts.get(self._script, "") + data


def unpack(packed: dict[str, Any]) -> np.ndarray:
    """What a page has packed, to within half a step of its scale."""
    raw = np.frombuffer(base64.b64decode(packed["data"]), dtype=f"<{packed['type']}").reshape(packed["shape"])
    return raw * packed["scale"] if "scale" in packed else raw
