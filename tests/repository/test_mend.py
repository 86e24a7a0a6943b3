"""What is mended in a page before it is written."""

from __future__ import annotations

from typing import Any

import pytest

from tests.helpers.docs_modules import docs_module


@pytest.fixture(scope="module")
def mend() -> Any:
    return docs_module("mend")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('<thead>\n<tr><th class="head"></th><th><p></p></th></tr>\n</thead>\n<tbody>', "<tbody>"),
        (
            '<thead><tr><th class="head"></th><th class="head">rate</th></tr></thead>',
            '<thead><tr><td class="head"></td><th class="head">rate</th></tr></thead>',
        ),
        ('<thead><tr><th><img src="a.png"></th></tr></thead>', '<thead><tr><th><img src="a.png"></th></tr></thead>'),
    ],
)
def test_headers_that_say_nothing(before: str, after: str, mend: Any) -> None:
    assert mend.without_empty_headers(before) == after


def test_arguments_are_lines_and_lists_stay_lists(mend: Any) -> None:
    listed = "<dl>\n<dt>a</dt><dd><p>b</p></dd></dl>"
    arguments = "<dt>f(\n\n<dl>\n<dd><em>a</em>,</dd>\n<dd>b</dd>\n</dl>\n\n)</dt>"
    lines = '<dt>f(\n\n<div class="sig-lines">\n<div><em>a</em>,</div>\n<div>b</div>\n</div>\n\n)</dt>'
    assert mend.with_lines_of_arguments(listed + arguments + listed) == listed + lines + listed


def test_each_name_of_a_file_leads_back_to_where_it_is_public(mend: Any) -> None:
    public = {"uavrl.lidar.cells": "api.html#1", "uavrl.Lidar": "api.html#2", "uavrl.Lidar.scan": "api.html#3"}
    code = '<div class="viewcode-block" id="{}">\n<a class="viewcode-back" href="{}">[docs]</a>\n'
    names = ["cells", "Lidar", "Lidar.scan", "elsewhere"]
    html = mend.with_links_back("".join(code.format(name, "old") for name in names), "uavrl.lidar", public.get)
    assert html == "".join(map(code.format, names, ["api.html#1", "api.html#2", "api.html#3", "old"]))
