"""What the check of the built site finds, on pages of a few lines."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tools import check_site

PAGE = '<html lang="en"><head><title>A</title></head><body>{}<h1 id="a">A</h1></body></html>'


def site(folder: Path, **pages: str) -> list[str]:
    for name, text in pages.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return check_site.faults(folder)


GOOD = [
    '<a href="b.html#b">b</a> <a href="#a">a</a> <a href="#">a</a> <a href="b.html?v=1#b%62">bb</a>',
    '<a href="#old">a</a> <a id="old" name="old">b</a>',
    '<a href="https://example.org/nothing.html#there">away</a> <a href="mailto:a@example.org">mail</a>',
    '<img src="b.html" alt=""><img src="data:image/png;base64,AA" alt="a dot"/>',
    '<svg><title>An icon</title><symbol id="sun"/><use href="#sun"/></svg>',
    '<table><thead><tr><td></td><th>rate</th><th><img src="b.html" alt="how far"></th></tr></thead></table>',
    "<dl><dt>TD3<dd>an algorithm<dl><dt>policy</dt><dd>its actor</dd></dl></dl>",
    '<p role="heading" aria-level="2">More</p><aside aria-label="All pages"></aside>',
    '<label for="wide">Wide</label><input id="wide"><p>one<p>two<br>',
]


@pytest.mark.parametrize("body", GOOD)
def test_a_clean_page_passes(body: str, tmp_path: Path) -> None:
    other = PAGE.format('<p id="b">B</p><p id="bb"></p>')
    assert site(tmp_path, a=PAGE.format(body), b=other) == []


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ('<a href="no.html#a">a</a>', "links to no.html#a, where no file is"),
        ('<script src="../a/no.js?v=1"></script>', "links to ../a/no.js?v=1, where no file is"),
        ('<a href="#no">a</a>', "links to #no, where no such anchor is"),
        ('<a href="b.html#a%20b">a</a>', "links to b.html#a%20b, where no such anchor is"),
        ('<a href="../outside.html">a</a>', "links to ../outside.html, which is not of the site"),
        ('<label for="no">a</label>', "links to #no, where no such anchor is"),
        ('<p id="a">a</p>', 'has the id "a" 2 times'),
        ('<img src="b.html">', "shows b.html without alternative text: <img alt=…>"),
        ('<img src="b.html" alt="../img/b.html">', "shows b.html without alternative text: <img alt=…>"),
        ("<h1>B</h1>", "has 2 <h1> with text, in place of one"),
        ("<svg></svg><title>B</title>", "has 2 <title> with text, in place of one"),
        ("<table><tr><th> <p></p></th></tr></table>", "has a table with an empty header cell: <th>"),
        ("<dl><dd>a</dd></dl>", "has a list of definitions without a term: <dl> without <dt>"),
        ('<p role="heading">More</p>', "has a <p role=heading> without aria-level"),
        ('<aside class="toc"></aside>', "has an <aside class=toc> without aria-label"),
    ],
)
def test_each_fault_is_one_sentence(body: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "outside.html").write_text("")
    assert site(tmp_path / "a", a=PAGE.format(body), b=PAGE.format("")) == [f"a.html {told}."]


def test_a_page_that_says_nothing_of_itself(tmp_path: Path) -> None:
    assert site(tmp_path, a="<html><title> </title><p>A</p></html>") == [
        "a.html has 0 <title> with text, in place of one.",
        "a.html has 0 <h1> with text, in place of one.",
        "a.html does not say its language: <html lang=…>.",
    ]


def test_pages_below_and_folders(tmp_path: Path) -> None:
    (tmp_path / "api").mkdir()
    (tmp_path / "api/index.html").write_text(PAGE.format('<a href="../a.html#b">b</a>'), encoding="utf-8")
    found = site(tmp_path, a=PAGE.format('<a href="api/#a">a</a> <a href="api#b">b</a>'))
    assert found == [
        "a.html links to api#b, where no such anchor is.",
        "api/index.html links to ../a.html#b, where no such anchor is.",
    ]


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["check_site", str(tmp_path)])
    with pytest.raises(SystemExit, match="build again"):
        check_site.main()
    assert "found no .html: build them with make docs." in capsys.readouterr().out
    assert site(tmp_path, a=PAGE.format("")) == []
    check_site.main()
    assert capsys.readouterr().out == f"no faults in the pages of {tmp_path}\n"
