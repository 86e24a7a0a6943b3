"""The site, built as `make docs` does but for its tutorials, which are not run: nothing is wrong with its pages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.folders import ROOT
from tools.check_site import faults


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for module in ("furo", "myst_nb", "sphinx_copybutton"):
        pytest.importorskip(module, reason="needs what builds the site: pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    found = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "-D", "nb_execution_mode=off"]
    built = subprocess.run(
        [*command, "-d", str(folder / "trees"), "docs", str(folder / "html")],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": found},
        timeout=800,
    )
    assert built.returncode == 0, built.stderr[-3000:]
    return folder / "html"


def test_nothing_is_wrong_with_the_pages(site: Path) -> None:
    assert faults(site) == []
    pages = {str(page.relative_to(site)) for page in site.rglob("*.html")}
    assert pages >= {"index.html", "search.html", "genindex.html", "api/losses.html", "_modules/uavrl/losses/td3.html"}


def test_the_parts_of_each_page_have_names(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for name in ("All pages", "On this page", "Source and colours"):
            assert text.count(f'aria-label="{name}"') == 1, (page, name)
