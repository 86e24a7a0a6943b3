"""Files are UTF-8, whatever the encoding of the terminal: every call that opens a text says so."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
TEXTS = {"read_text": 0, "write_text": 1, "open": 0}  # how many arguments stand before the encoding's or the mode's
LIBRARY = ("uavrl", "benchmarks", "studies", "examples", "docs")


def without_encoding(source: str) -> Iterator[ast.Call]:
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        owner = (
            node.func.value.id if isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name) else ""
        )
        if called not in TEXTS or owner in ("os", "zipfile", "Image", "webbrowser", "urllib", "av"):
            continue
        modes = [a.value for a in (*node.args, *(k.value for k in node.keywords)) if isinstance(a, ast.Constant)]
        binary = called == "open" and any("b" in str(mode) and len(str(mode)) <= 3 for mode in modes)
        if not binary and not any(keyword.arg == "encoding" for keyword in node.keywords):
            yield node


def test_every_text_file_has_its_encoding() -> None:
    files = [
        path for folder in LIBRARY for path in (ROOT / folder).rglob("*.py") if not {"_build", "tests"} & {*path.parts}
    ]
    assert len(files) > 150
    found = [
        f"{path.relative_to(ROOT)}:{c.lineno}" for path in files for c in without_encoding(path.read_text("utf-8"))
    ]
    assert found == []
