"""A rate and its interval stay together in the site's tables."""

from __future__ import annotations

from typing import Any

import pytest

from tests.helpers.docs_modules import DOCS, docs_module


@pytest.fixture(scope="module")
def tables() -> Any:
    return docs_module("tables")


@pytest.mark.parametrize(
    ("text", "together"),
    [
        ("99.6 % (98.6–99.9)", ["99.6 %", "(98.6–99.9)"]),
        ("+16.5 (+3.7 to +32.3)", ["(+3.7 to +32.3)"]),
        ("63 % (55–71) of 136", ["63 %", "(55–71)"]),
        ("72–86 % of them (see below)", ["72–86 %"]),
        ("5,000 episodes", []),
    ],
)
def test_the_pieces_of_a_cell(text: str, together: list[str], tables: Any) -> None:
    pieces = list(tables.pieces(text))
    assert "".join(piece for piece, _ in pieces) == text
    assert [piece for piece, whole in pieces if whole] == together


def test_they_are_marked_in_cells_and_left_alone_in_code(tables: Any) -> None:
    nodes = pytest.importorskip("docutils.nodes", reason="comes with the extra docs")
    cell = nodes.entry(
        "", nodes.paragraph("", "", nodes.strong("", "9 %"), nodes.Text(" (8–10), "), nodes.literal("", "1 %"))
    )
    page = nodes.document(None, None)
    page += [cell, nodes.paragraph("", "5 % (4–6)")]
    tables.keep_together(page)
    marked = [node.astext() for node in page.findall(nodes.inline) if "together" in node["classes"]]
    assert marked == ["9 %", "(8–10)"] and page.astext() == "9 % (8–10), 1 %\n\n5 % (4–6)"


def test_the_site_does_not_break_them_and_cuts_no_line_off() -> None:
    style = (DOCS / "_static/site.css").read_text(encoding="utf-8")
    assert ".together { white-space: nowrap; }" in style and "pre { white-space: pre-wrap;" in style
